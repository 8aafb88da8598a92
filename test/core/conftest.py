"""Property tests draw the same examples at every run, and may take what time a busy machine needs."""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
