"""
Options learned from demonstrations, and SMDP planning with them.

The workflow: ``demonstrations_from_table`` or ``make_demonstration``, ``learn_option``,
``judge``, ``plan``, ``judge_plan``. Everything here works without ROS; the nodes are in ``ros``.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)  # names are listed in __init__.pyi
