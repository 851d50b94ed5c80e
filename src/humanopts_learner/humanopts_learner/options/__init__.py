"""Options: learning from demonstrations, evaluation, execution, and storage in files."""
