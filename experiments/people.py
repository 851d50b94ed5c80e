"""
The simulated participants of a study: a table drawn from its seed.

Two groups, since the paper's claims are of two kinds. *Careful* people make no error; they differ
only in which of several equally good actions they prefer. *Varied* people differ in that too, and
each has an error rate of their own (share of steps that are wrong, from 0 to ``MOST_ERRORS``) and
a rate of needless answers (probability of yes to a question about a feature that does not matter,
from 0 to ``MOST_NEEDLESS``). So that a handful of people covers both ranges, their rates are not
drawn one by one: they go on from an offset that is drawn, by steps that fill a square evenly
(Roberts 2018, The unreasonable effectiveness of quasirandom sequences: R2).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from humanopts_env.seeding import generator
from humanopts_teach.lesson.simulated_teacher import TeacherSettings

CAREFUL, VARIED = 'careful', 'varied'
GROUPS = (CAREFUL, VARIED)
MOST_ERRORS = 0.05
MOST_NEEDLESS = 0.2
STEPS = (0.7548776662466927, 0.5698402909980532)  # 1 / g, 1 / g**2, where g**3 = g + 1


@dataclass(frozen=True)
class Participant:
    """One simulated person; every other draw of theirs is keyed by code and seed."""

    group: str
    code: str
    error_rate: float  # share of steps that are wrong
    needless_rate: float  # probability of a needless yes for each feature
    seed: int  # of the study

    def to_dict(self) -> dict[str, Any]:
        """Return the person as JSON data."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> 'Participant':
        """Read what ``to_dict`` wrote."""
        return cls(**values)

    def teaching(self, *options: str) -> TeacherSettings:
        """Return the person as a teacher of some options."""
        return TeacherSettings(
            options=options,
            participant=self.code,
            session='study',
            error_rate=self.error_rate,
            extra_feature_rate=self.needless_rate,
            own_habits=True,
            seed=self.seed,
        )


def participants(group: str, count: int, seed: int) -> list[Participant]:
    """Draw the first people of a group; more of them leave the first as they are."""
    return [_participant(group, number, seed) for number in range(1, count + 1)]


def _participant(group: str, number: int, seed: int) -> Participant:
    offsets = generator(seed, 'participants', group).uniform(size=2).tolist()
    errors, needless = ((x + number * step) % 1.0 for x, step in zip(offsets, STEPS))
    varied = group == VARIED
    return Participant(
        group,
        f'{group}{number}',
        error_rate=round(errors * MOST_ERRORS, 4) if varied else 0.0,
        needless_rate=round(needless * MOST_NEEDLESS, 4) if varied else 0.0,
        seed=seed,
    )
