"""What takes how long, measured by pytest-benchmark: ``humanopts bench`` runs these files."""
