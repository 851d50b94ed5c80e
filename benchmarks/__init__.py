"""Timings measured by pytest-benchmark: ``humanopts bench`` runs these files."""
