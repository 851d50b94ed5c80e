"""What every humanopts node shares; it knows no game and no option."""
