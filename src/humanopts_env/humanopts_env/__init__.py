"""
Games as domains: rules without hidden state, reference options, conversion to and from Gymnasium.

The entry point is ``make_domain('taxi')``. Everything here works without ROS.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)  # the names are in __init__.pyi
