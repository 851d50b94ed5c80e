"""What all tests share: examples of Hypothesis take what time they need, as on a busy machine."""

from hypothesis import settings

settings.register_profile('humanopts', deadline=None)
settings.load_profile('humanopts')
