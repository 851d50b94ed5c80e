"""Settings of all tests: no Hypothesis deadlines, no garbage collection before the first test."""

import gc

from hypothesis import settings

# No deadline for examples, since the machine may be busy.
settings.register_profile('humanopts', deadline=None)
settings.register_profile('few', deadline=None, max_examples=20)  # for make test-floor
settings.load_profile('humanopts')
gc.disable()


def pytest_collection_finish() -> None:
    """Exclude imported objects from garbage collection, which every graph triggers."""
    gc.freeze()
    gc.enable()
