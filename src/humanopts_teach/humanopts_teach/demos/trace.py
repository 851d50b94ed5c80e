"""The episode that is being played, collected step by step from the stream of game states."""

from humanopts_env.game import Transition


class Trace:
    """The newest episode, from its first moment on without gaps."""

    def __init__(self) -> None:
        self.moments: list[Transition] = []
        self.broken = ''  # what is missing, in words; empty: nothing

    @property
    def episode(self) -> int:
        """Number of the episode, 0 before the first."""
        return self.moments[-1].episode if self.moments else 0

    @property
    def last(self) -> int:
        """Step of the newest state, -1 before the first."""
        return self.moments[-1].step if self.moments else -1

    def add(self, moment: Transition) -> None:
        """Take the next moment; step 0 or another episode begins anew."""
        if moment.step == 0 or moment.episode != self.episode:
            self.moments, self.broken = [], ''
            if moment.step != 0:
                self.broken = (
                    f'the first {moment.step} steps of episode {moment.episode} are missing'
                )
        elif moment.step != self.last + 1:
            self.broken = self.broken or (
                f'step {moment.step} of episode {moment.episode} came after step {self.last}'
            )
        self.moments.append(moment)
