"""Episodes of a bag as a Minari dataset, which steps through our Gymnasium environments."""

from hashlib import sha256
import os
from pathlib import Path
import re
import shutil
from tempfile import TemporaryDirectory
from typing import Any
import warnings

from humanopts_env.domains.base import action_index, Domain
from humanopts_env.gym_env import spec_of
from humanopts_teach.bags.contents import (
    Beginnings,
    Episode,
    namespace,
    read_beginnings,
    read_domain,
    read_episodes,
)
from humanopts_teach.bags.reader import Bag
from humanopts_teach.export.tables import ExportError
import numpy as np

FOLDER = 'MINARI_DATASETS_PATH'  # where Minari looks for datasets
FORMAT = 'arrow'
AUTHOR = 'humanopts'
MAX_NAME = 64  # characters of a bag's name in the id of its dataset


def write_dataset(bag: Bag, out: Path) -> tuple[str, int]:
    """
    Write the episodes that were recorded from their first state without a gap.

    Each carries ``options`` for ``reset``: with them, and the recorded actions, our environment
    gives the recorded observations, rewards and ends again. An episode that was broken off, as a
    demonstration is that is done, is truncated in its last step: Minari knows no other end.

    The dataset is written whole or not at all.

    :param out: folder that Minari is to look in, from now on in this process.
    :return: id of the dataset, and how many episodes it has; ``Bag.damage`` says what is left out.
    :raises BagError: the bag does not say which domain was played, or it is not installed.
    :raises ExportError: Minari is not installed, there is nothing to write, or the dataset is
        there already.
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
    whole = [
        each
        for each in episodes
        if len(each.transitions) > 1
        and [at.step for at in each.transitions] == list(range(len(each.transitions)))
    ]
    if not whole:
        raise ExportError(f'{bag.path} holds no episode that was recorded without a gap')
    spec = spec_of(domain)
    env = spec.make()
    begun = read_beginnings(bag)
    buffers = (
        EpisodeBuffer(
            id=number, options=_reset_options(begun, one), **_columns(env.unwrapped, one)
        )
        for number, one in enumerate(whole)
    )
    description = (
        f'Recorded episodes of {domain.name}. Begin each with '
        'env.reset(options=dataset.storage.get_episode_metadata([id])["options"]).'
    )
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix='.unfinished-', dir=out) as unfinished:
        os.environ[FOLDER] = os.path.abspath(unfinished)  # Minari cannot write in a relative one
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', UserWarning)  # that no author is named, and the like
            try:
                minari.create_dataset_from_buffers(
                    name, buffers, env=spec, data_format=FORMAT, description=description
                )
            except ValueError as error:
                raise ExportError(f'the dataset cannot be written: {error}') from error
        _move_dataset(Path(unfinished), out, name)
    os.environ[FOLDER] = os.path.abspath(out)
    if left_out := len(episodes) - len(whole):
        bag.note(f'{left_out} episodes are left out: of one state, or with steps missing')
    return name, len(whole)


def dataset_name(domain: Domain[Any], bag: Path) -> str:
    """
    Return the id of a bag's dataset, which no bag of another name has.

    Minari takes letters, digits, - and _; a name with others gets a digest.
    """
    place = bag.resolve()
    name = place.name.removesuffix('.mcap')
    readable = _readable(name)[:MAX_NAME]
    if readable != name:
        readable = f'{readable}-{sha256(os.fsencode(name)).hexdigest()[:8]}'.lstrip('-')
    return f'{AUTHOR}/{_readable(domain.name)}/{readable}-v0'


def _readable(name: str) -> str:
    return re.sub(r'\W+', '-', name, flags=re.ASCII).strip('-')


def _move_dataset(source: Path, target: Path, name: str) -> None:
    """Move a finished dataset to the others, with what Minari knows of the folders above it."""
    for above in (Path(name).parent.parent, Path(name).parent):
        (target / above).mkdir(exist_ok=True)
        for known in (source / above).glob('*.json'):
            if not (target / above / known.name).exists():
                shutil.copyfile(known, target / above / known.name)
    (source / name).rename(target / name)


def _reset_options(begun: Beginnings, episode: Episode) -> dict[str, Any]:
    """Return the options of ``reset`` that repeat an episode: its start and its random draws."""
    first = episode.transitions[0].state
    request = begun.get((namespace(episode.topic), episode.number, first))
    if request is None:  # it was not recorded, so random draws cannot be repeated
        return {'state': first}
    if request.start_state:
        return {'state': request.start_state, 'game_seed': request.seed}
    return {'game_seed': request.seed}


def _columns(env: Any, episode: Episode) -> dict[str, Any]:
    """Return observations (T + 1), and actions, rewards and ends (T)."""
    domain: Domain[Any] = env.domain
    taken = episode.transitions[1:]
    states = [domain.decode(each.state) for each in episode.transitions]
    truncations = [each.truncated for each in taken]
    truncations[-1] |= not taken[-1].terminated
    return {
        'observations': np.array([env.observe(state) for state in states]),
        'actions': np.array([action_index(domain, each.previous_action) for each in taken]),
        'rewards': [each.reward for each in taken],
        'terminations': [each.terminated for each in taken],
        'truncations': truncations,
    }
