"""The paper's figures and tables: their trials, and the report of the results."""
