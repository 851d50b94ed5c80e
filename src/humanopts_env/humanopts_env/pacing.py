"""A game at a pace that people can watch: commands of machines wait for their time."""

from humanopts_env.game import Accepted, Command, Game, Reason, Refused, Source

Result = Accepted | Refused


class Pacing:
    """
    Keeps one command of a machine waiting; a person's are never delayed.

    A step is the first command's that answers it, as without pacing: while that one waits, others
    for the same step are refused as stale. What would be refused in any case does not wait.

    :ivar waiting: the command that waits; None: none does.
    """

    def __init__(self, game: Game) -> None:
        """Wait for nothing."""
        self._game = game
        self.waiting: Command | None = None

    def offer(self, command: Command) -> list[Result]:
        """
        Take a command that has come.

        :return: what came of it and, where it takes the place of a command whose moment has
            passed, of that one; nothing of a command that waits from now on.
        """
        game, before = self._game, self.waiting
        if command.source == Source.PERSON:
            return [game.command(command)]
        refused = game.refusal(command)
        if refused is not None:
            return [refused]
        overtaken = None if before is None else game.refusal(before)
        if before is not None and overtaken is None:
            detail = f'step {command.step} is answered: {before.action!r} waits for step_period'
            return [game.refuse(command, Reason.STALE, detail)]
        self.waiting = command
        return [] if overtaken is None else [overtaken]

    def due(self) -> list[Result]:
        """Carry out the command whose time has come."""
        command, self.waiting = self.waiting, None
        return [] if command is None else [self._game.command(command)]
