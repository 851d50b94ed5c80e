"""Export of episodes as a Minari dataset that uses the humanopts Gymnasium environments."""

from hashlib import sha256
import os
from pathlib import Path
import re
import shutil
from typing import Any
import warnings

from humanopts_env.domains.base import action_index, Domain
from humanopts_env.gym_env import spec_of
from humanopts_teach.bags.contents import Episode, read_domain, read_episodes
from humanopts_teach.bags.reader import Bag
from humanopts_teach.export.tables import ExportError
import numpy as np

FOLDER = 'MINARI_DATASETS_PATH'  # variable with Minari's dataset folder
MAX_NAME = 64  # characters of a bag name in a dataset id
_RESET_EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
_REQUEST, _RESPONSE = 1, 2  # server events in ServiceEventInfo: REQUEST_RECEIVED, RESPONSE_SENT
Requests = dict[tuple[int, str], Any]  # reset_game requests, by episode number and first state


def write_dataset(bag: Bag, out: Path) -> tuple[str, int]:
    """
    Write the episodes that were recorded from their first state without gaps.

    Each episode stores ``options`` for ``reset``: with these options and the recorded actions, the
    environment reproduces the recorded observations, rewards and ends. An episode that was cut
    short, such as a completed demonstration, is truncated at its last step, since Minari has no
    suitable kind of end.

    An incomplete dataset is removed.

    :param out: folder of Minari's datasets; also set in the environment of this process.
    :return: dataset id and number of episodes; omitted episodes are listed in ``Bag.damage``.
    :raises BagError: the bag contains no domain or several, or the domain is not installed.
    :raises ExportError: Minari is not installed, there is nothing to write, or the dataset exists.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
        import pyarrow  # noqa: F401, Minari's storage backend
    except ImportError as error:
        raise ExportError(
            'a Minari dataset needs minari, which is not installed: pip install "minari[arrow]"'
        ) from error
    domain = read_domain(bag)
    name = dataset_name(domain, bag.path)
    if (out / name).exists():
        raise ExportError(f'{out / name} already exists; choose another folder, or remove it')
    episodes = list(read_episodes(bag))
    whole = [each for each in episodes if len(each.transitions) > 1 and not each.has_gaps]
    if not whole:
        raise ExportError(f'{bag.path} holds no episode that was recorded without a gap')
    spec, requests = spec_of(domain), _reset_requests(bag)
    env = spec.make().unwrapped
    buffers = (
        EpisodeBuffer(id=number, options=_reset_options(requests, each), **_columns(env, each))
        for number, each in enumerate(whole)
    )
    description = (
        f'Recorded episodes of {domain.name}. Begin each with '
        'env.reset(options=dataset.storage.get_episode_metadata([id])["options"]).'
    )
    os.environ[FOLDER] = os.path.abspath(out)  # Minari cannot write to a relative path
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', UserWarning)  # such as those about missing authors
            minari.create_dataset_from_buffers(
                name, buffers, env=spec, data_format='arrow', description=description
            )
    except BaseException as error:
        shutil.rmtree(out / name, ignore_errors=True)
        if isinstance(error, ValueError):
            raise ExportError(f'the dataset cannot be written: {error}') from error
        raise
    if omitted := len(episodes) - len(whole):
        bag.note(f'{omitted} episodes are left out: of one state, or with steps missing')
    return name, len(whole)


def dataset_name(domain: Domain, bag: Path) -> str:
    """
    Return the dataset id of a bag, unique for each bag name.

    Minari accepts letters, digits, - and _; a digest is added to other names.
    """
    name = bag.resolve().name.removesuffix('.mcap')
    of_domain, of_bag = (
        re.sub(r'\W+', '-', text, flags=re.ASCII).strip('-') for text in (domain.name, name)
    )
    if of_bag != name or len(name) > MAX_NAME:
        digest = sha256(os.fsencode(name)).hexdigest()[:8]
        of_bag = f'{of_bag[:MAX_NAME]}-{digest}'.lstrip('-')
    return f'humanopts/{of_domain}/{of_bag}-v0'


def _reset_requests(bag: Bag) -> Requests:
    """Return the recorded reset_game requests that started episodes."""
    waiting: dict[tuple[Any, ...], Any] = {}  # requests without a response so far
    found: Requests = {}
    for event in bag.converted(_RESET_EVENT, lambda event: event):
        call = tuple(event.info.client_gid), event.info.sequence_number
        if event.info.event_type == _REQUEST and event.request:
            waiting[call] = event.request[0]
        elif event.info.event_type == _RESPONSE and event.response and call in waiting:
            answer = event.response[0]
            found[answer.episode, answer.state] = waiting.pop(call)
    return found


def _reset_options(requests: Requests, episode: Episode) -> dict[str, Any]:
    """Return the ``reset`` options that reproduce an episode's start and random draws."""
    first = episode.transitions[0].state
    request = requests.get((episode.number, first))
    if request is None:  # not recorded: random draws are not reproducible
        return {'state': first}
    start = {'state': request.start_state} if request.start_state else {}
    return {**start, 'game_seed': request.seed}


def _columns(env: Any, episode: Episode) -> dict[str, Any]:
    """Return T + 1 observations, and T actions, rewards and ends."""
    domain: Domain = env.domain
    _, *taken = episode.transitions
    truncations = [each.truncated for each in taken]
    truncations[-1] |= not taken[-1].terminated
    return {
        'observations': np.array(
            [env.observe(domain.decode(e.state)) for e in episode.transitions]
        ),
        'actions': np.array([action_index(domain, each.previous_action) for each in taken]),
        'rewards': [each.reward for each in taken],
        'terminations': [each.terminated for each in taken],
        'truncations': truncations,
    }
