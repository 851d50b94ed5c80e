"""
Lessons in which people teach options: teachers, bags, evaluation and reports.

Everything here works without ROS; the nodes are in ``ros``, the command line is ``cli``.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)  # the names are in __init__.pyi
