"""A teaching session: what is asked, kept and shown, as pure values and rules, without ROS."""

from typing import Final

STRATEGY: Final = 'failures'  # of start states, unless another is asked for
METHOD: Final = 'trees'  # of learning, unless another is asked for
BUDGET = 150  # the most start states that are shown for one option, "not here" answers included
