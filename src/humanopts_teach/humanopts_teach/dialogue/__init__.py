"""The dialogue with a person as pure code: keys and news in, screens and requests out."""
