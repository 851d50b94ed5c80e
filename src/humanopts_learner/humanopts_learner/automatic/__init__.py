"""Options found without a person, by the algorithm of Stolle and Precup (2002)."""
