"""The dialogue with a person, free of I/O: keys and events in, screens and requests out."""
