"""What all tests share: Hypothesis has no deadlines; collecting looks for no garbage."""

import gc

from hypothesis import settings

# Examples take what time they need, as on a busy machine.
settings.register_profile('humanopts', deadline=None)
settings.register_profile('few', deadline=None, max_examples=20)  # of make test-floor
settings.load_profile('humanopts')
gc.disable()


def pytest_collection_finish() -> None:
    """Leave what was imported out of each search for garbage, of which every graph makes one."""
    gc.freeze()
    gc.enable()
