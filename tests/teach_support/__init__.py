"""What tests of the teaching package share."""
