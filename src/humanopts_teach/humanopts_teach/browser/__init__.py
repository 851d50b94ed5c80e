"""The dialogue with a person as pages in a browser; NiceGUI is imported only to serve them."""
