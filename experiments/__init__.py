"""The paper's figures and tables again: cells that are computed once, and what is made of them."""
