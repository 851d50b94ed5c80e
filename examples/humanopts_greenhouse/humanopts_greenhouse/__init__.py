"""A third-party domain, which needs no changes in humanopts."""
