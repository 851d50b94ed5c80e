"""The paper's figures and tables: trials and a report of their results."""
