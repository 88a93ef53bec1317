"""Settings of all tests."""

from hypothesis import settings

# A test is right or wrong, however busy the machine is.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
