"""
Text colours, by their rich names, that are readable on black and on white.

Each is one of the 240 fixed colours of 256-colour terminals, so that themes do not change it. Its
contrast with black and with white is 3.5 or more (WCAG 2.2, success criterion 1.4.11, requires 3).
"""

RED, ORANGE, GREEN, TEAL = 'color(160)', 'color(130)', 'color(28)', 'color(30)'
BLUE, MAGENTA, GREY = 'color(27)', 'color(163)', 'color(243)'
