"""Options: learned from demonstrations, judged, run, and kept as files."""
