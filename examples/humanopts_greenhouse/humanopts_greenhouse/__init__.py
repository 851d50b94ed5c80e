"""A domain of another author, played by humanopts without a change in it."""
