"""Planning from samples, in domains that are not enumerable."""
