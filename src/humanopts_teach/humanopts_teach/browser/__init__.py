"""The dialogue with a person as pages in a browser; NiceGUI is imported where they are served."""
