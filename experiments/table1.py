"""
Table 1: the buttons requested by people (section 4).

Nothing is computed, since simulated people request nothing. The section explains this and lists
where the paper's buttons are taught here. ``humanopts bag table1`` counts the options named by
people in lessons.
"""

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_teach.evaluation.table1 import TABLE_1
import pandas as pd

from experiments import paper
from experiments.report import compare, Mark, Section, Table

NAME = 'table1'
TITLE = 'Table 1: the options that people name'
WHY = {  # reason why a statement cannot be compared
    'buttons': 'simulated people name nothing; the options that people named are taught here',
    'options': 'this needs a study with people; the same programs record and read yours',
    'taught': 'people are simulated where none are given with --bags',
}


def present() -> Section:
    """Return the section of the report: the paper's buttons, and where they are taught here."""
    rows = [
        (domain, button, share, _taught(domain, button))
        for domain, buttons in TABLE_1.items()
        for button, share in buttons.items()
    ]
    frame = pd.DataFrame(rows, columns=['domain', 'button', "paper's share of people", 'here'])
    said = [compare(paper.SAID[key], Mark.NO_COUNTERPART, why=why) for key, why in WHY.items()]
    return Section(
        NAME, TITLE, said, tables=[Table('table1', "The paper's buttons, and ours", frame)]
    )


def _taught(domain: str, button: str) -> str:
    """Describe where a button of the paper is taught as an option."""
    if button in paper.TAUGHT[domain]:
        return 'taught in figure 2 and table 2'
    if button in paper.ALSO_NAMED.get(domain, ()):
        return 'taught in table 2'
    known = button in reference_options(make_domain(domain))
    return 'can be taught; not in figures or table 2' if known else 'none'
