"""
Games as domains: rules without hidden state, reference options, Gymnasium in both directions.

``make_domain('taxi')`` is the way in. Everything here works without ROS.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)  # the names are in __init__.pyi
