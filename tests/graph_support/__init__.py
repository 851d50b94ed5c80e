"""What the tests of the live graph share."""
