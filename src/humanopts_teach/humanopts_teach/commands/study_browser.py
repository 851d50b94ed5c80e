"""``humanopts study --browser``: each page takes a participant through all conditions."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress

from humanopts_teach.browser.seats import ConditionSeat, GameError, message, Press, Seat
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.browser import game, serve_seats
from humanopts_teach.commands.options import PageOptions
from humanopts_teach.commands.study_session import Study
from humanopts_teach.ros.browser_teleop import TeleopThread


def study_in_browser(study: Study, pages: PageOptions, participant: str) -> int:
    """
    Serve pages until Ctrl-C; parameters and errors are those of ``serve_seats``.

    :param study: whose participants each have a page.
    """

    def open_game(thread: TeleopThread, seat: Seat) -> AbstractAsyncContextManager[Press]:
        return _all_turns(study, thread, seat)

    print(f'{study.plan.name}: everything is kept in {study.folder.path}.')
    return serve_seats(study.plan.name, open_game, pages, participant)


@asynccontextmanager
async def _all_turns(study: Study, thread: TeleopThread, seat: Seat) -> AsyncIterator[Press]:
    """Keep one game after the other, each of a condition; the last one ends the seat."""
    press: Press = _nothing

    async def play() -> None:
        nonlocal press
        try:
            participant = study.enter(seat.participant)
            while (turn := study.next_turn(participant)) is not None:
                condition = ConditionSeat(seat)
                async with game(turn.setup, study.namespace, thread, condition) as pressed:
                    press = pressed
                    await condition.over.wait()
                    press = _nothing
                    seat.show(message(seat.head, 'The next part is being prepared ...'), 0)
                if farewell := condition.farewell or study.farewell(participant, turn):
                    seat.end(farewell)
                    return
            seat.end(study.finish(participant))
        except (CommandError, GameError) as error:
            seat.end(str(error))

    playing = asyncio.create_task(play())
    try:
        yield lambda keys, frame: press(keys, frame)
    finally:
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing


def _nothing(keys: list[str], frame: int) -> None:
    """Take no keys: one condition has ended, and the next one is not ready."""
