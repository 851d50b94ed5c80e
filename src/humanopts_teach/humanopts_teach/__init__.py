"""
Lessons in which people teach options: teachers, bags, evaluation and reports.

Everything here works without ROS; the nodes are in ``ros``, the command line is ``cli``.
"""

from typing import TYPE_CHECKING

from humanopts_env.lazy import lazy_names

if TYPE_CHECKING:
    from humanopts_teach.bags.contents import read_demonstrations, read_domain
    from humanopts_teach.bags.errors import BagError
    from humanopts_teach.bags.info import summarise
    from humanopts_teach.bags.reader import Bag, open_bag
    from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, evaluate_bag
    from humanopts_teach.lesson.simulated_teacher import SimulatedTeacher, TeacherSettings
    from humanopts_teach.report.write import write_evaluation_report

__all__ = [
    'Bag',
    'BagError',
    'BagEvaluation',
    'SimulatedTeacher',
    'TeacherSettings',
    'evaluate_bag',
    'open_bag',
    'read_demonstrations',
    'read_domain',
    'summarise',
    'write_evaluation_report',
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        'humanopts_teach.bags.contents': ('read_demonstrations', 'read_domain'),
        'humanopts_teach.bags.errors': ('BagError',),
        'humanopts_teach.bags.info': ('summarise',),
        'humanopts_teach.bags.reader': ('Bag', 'open_bag'),
        'humanopts_teach.evaluation.bag_evaluation': ('BagEvaluation', 'evaluate_bag'),
        'humanopts_teach.report.write': ('write_evaluation_report',),
        'humanopts_teach.lesson.simulated_teacher': ('SimulatedTeacher', 'TeacherSettings'),
    },
)
