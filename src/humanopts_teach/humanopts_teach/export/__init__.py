"""Export of bags to formats of other tools."""
