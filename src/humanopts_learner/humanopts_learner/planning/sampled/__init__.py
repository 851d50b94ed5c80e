"""Planning from samples, in domains whose states cannot all be listed."""
