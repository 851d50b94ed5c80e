"""
Options learned from demonstrations, and SMDP planning with them.

The way through: ``demonstrations_from_table`` or ``make_demonstration``, ``learn_option``,
``judge``, ``plan``, ``judge_plan``. Everything here works without ROS; the nodes are in ``ros``.
"""

from typing import TYPE_CHECKING

from humanopts_env.lazy import lazy_names

if TYPE_CHECKING:
    from humanopts_learner.automatic.extract import find_options
    from humanopts_learner.demonstration_table import (
        demonstrations_from_table,
        demonstrations_to_table,
    )
    from humanopts_learner.demonstrations import Demonstration, make_demonstration
    from humanopts_learner.options.accuracy import classification_accuracy, policy_accuracy
    from humanopts_learner.options.criteria import judge, Thresholds
    from humanopts_learner.options.files import load_option, save_option
    from humanopts_learner.options.learn import learn_option
    from humanopts_learner.options.option import LearnedOption
    from humanopts_learner.options.start_states import choose_start_state
    from humanopts_learner.planning.any_domain import judge_plan, plan
    from humanopts_learner.planning.value_iteration import solve_smdp

__all__ = [
    'Demonstration',
    'LearnedOption',
    'Thresholds',
    'choose_start_state',
    'classification_accuracy',
    'demonstrations_from_table',
    'demonstrations_to_table',
    'find_options',
    'judge',
    'judge_plan',
    'learn_option',
    'load_option',
    'make_demonstration',
    'plan',
    'policy_accuracy',
    'save_option',
    'solve_smdp',
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        'humanopts_learner.automatic.extract': ('find_options',),
        'humanopts_learner.demonstration_table': (
            'demonstrations_from_table',
            'demonstrations_to_table',
        ),
        'humanopts_learner.demonstrations': ('Demonstration', 'make_demonstration'),
        'humanopts_learner.options.accuracy': ('classification_accuracy', 'policy_accuracy'),
        'humanopts_learner.options.criteria': ('Thresholds', 'judge'),
        'humanopts_learner.options.files': ('load_option', 'save_option'),
        'humanopts_learner.options.learn': ('learn_option',),
        'humanopts_learner.options.option': ('LearnedOption',),
        'humanopts_learner.options.start_states': ('choose_start_state',),
        'humanopts_learner.planning.any_domain': ('judge_plan', 'plan'),
        'humanopts_learner.planning.value_iteration': ('solve_smdp',),
    },
)
