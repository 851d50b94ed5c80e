"""Episodes of a bag as a Minari dataset, which steps through our Gymnasium environments."""

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

FOLDER = 'MINARI_DATASETS_PATH'  # where Minari looks for datasets
MAX_NAME = 64  # characters of a bag's name in the id of its dataset
_RESET_EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
_REQUEST, _RESPONSE = 1, 2  # ServiceEventInfo: REQUEST_RECEIVED, RESPONSE_SENT; of the server
Requests = dict[tuple[int, str], Any]  # to reset_game, by number and first state of the episode


def write_dataset(bag: Bag, out: Path) -> tuple[str, int]:
    """
    Write the episodes that were recorded from their first state without a gap.

    Each carries ``options`` for ``reset``: with them, and the recorded actions, our environment
    gives the recorded observations, rewards and ends again. An episode that was broken off, as a
    completed demonstration is, is truncated in its last step: Minari knows no other end.

    A dataset that cannot be written whole is removed.

    :param out: folder of Minari's datasets, from now on in this process.
    :return: id of the dataset, and its number of episodes; ``Bag.damage`` says what is left out.
    :raises BagError: the bag does not say which domain was played, or it is not installed.
    :raises ExportError: Minari is not installed, there is nothing to write, or the dataset exists.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
        import pyarrow  # noqa: F401, what Minari stores with
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
    os.environ[FOLDER] = os.path.abspath(out)  # Minari cannot write in a relative one
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', UserWarning)  # that no author is named, and the like
            minari.create_dataset_from_buffers(
                name, buffers, env=spec, data_format='arrow', description=description
            )
    except BaseException as error:
        shutil.rmtree(out / name, ignore_errors=True)
        if isinstance(error, ValueError):
            raise ExportError(f'the dataset cannot be written: {error}') from error
        raise
    if left_out := len(episodes) - len(whole):
        bag.note(f'{left_out} episodes are left out: of one state, or with steps missing')
    return name, len(whole)


def dataset_name(domain: Domain[Any], bag: Path) -> str:
    """
    Return the id of a bag's dataset, which no bag of another name has.

    Minari takes letters, digits, - and _; a name with other characters gets a digest.
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
    """Return the requests to reset_game that began episodes, where they were recorded."""
    waiting: dict[tuple[Any, ...], Any] = {}  # the response names the episode
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
    """Return the options of ``reset`` that repeat an episode: its start and its random draws."""
    first = episode.transitions[0].state
    request = requests.get((episode.number, first))
    if request is None:  # it was not recorded, so random draws cannot be repeated
        return {'state': first}
    start = {'state': request.start_state} if request.start_state else {}
    return {**start, 'game_seed': request.seed}


def _columns(env: Any, episode: Episode) -> dict[str, Any]:
    """Return observations (T + 1), and actions, rewards and ends (T)."""
    domain: Domain[Any] = env.domain
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
