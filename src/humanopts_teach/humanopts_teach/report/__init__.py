"""Reports, each a single self-contained HTML file."""
