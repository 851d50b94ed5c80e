"""Benchmarks of the whole: real processes on a graph of their own, tables and figures."""
