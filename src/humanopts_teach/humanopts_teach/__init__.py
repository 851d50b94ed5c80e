"""
Lessons in which people teach options: teachers, bags, evaluation and reports.

The package works without ROS, except for the nodes in ``ros``; the command line is ``cli``.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)  # declared in __init__.pyi
