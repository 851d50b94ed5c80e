"""The node learner on the real graph: it keeps what can be used, and says what cannot and why."""

from dataclasses import replace
import math
from pathlib import Path
import shutil
from typing import Any
from uuid import uuid4

from graph_support.live import GAME, Graph, LEARNER
from graph_support.scripted import expert, FETCH, TAXI, walk
from humanopts_interfaces.msg import Demonstration as DemonstrationMessage
from humanopts_interfaces.msg import DemonstrationReceipt, LearnedOption, LearningStatus
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.option_trainer import DATA_SET
from humanopts_learner.options.files import load_options, option_from_json
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_ros.qos import CURRENT, STREAM
import pytest

SEED = 4
ACCEPTED = DemonstrationReceipt.STATUS_ACCEPTED


class Learning:
    """A game, a learner with its folder, and the test in the lesson's place."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.folder = graph, graph.folder / 'options'
        self._out = graph.node.create_publisher(DemonstrationMessage, 'demonstrations', STREAM)
        self.receipts = graph.listen(DemonstrationReceipt, 'demonstration_receipts')
        self.statuses = graph.listen(LearningStatus, 'learning_status', CURRENT)
        self.options: list[LearnedOption] = graph.listen(LearnedOption, 'learned_options')
        graph.start(GAME)
        self.node = self.start()

    def start(self) -> Any:
        """Start the learner, and wait until it has said what it knows."""
        known = len(self.statuses)
        learner = self.graph.start(LEARNER, directory=self.folder, seed=SEED)
        self.graph.until(lambda: len(self.statuses) > known and self.is_complete(), 'all', 60.0)
        self.graph.until(self._out.get_subscription_count, 'it to listen')
        return learner

    def give(self, message: DemonstrationMessage) -> DemonstrationReceipt:
        """Send a demonstration and return its receipt."""
        known = len(self.receipts)
        self._out.publish(message)
        self.graph.until(lambda: len(self.receipts) > known, 'a receipt')
        receipt: DemonstrationReceipt = self.receipts[-1]
        assert (receipt.uuid, receipt.option_name) == (message.uuid, message.option_name)
        if receipt.status == ACCEPTED:
            self.graph.until(
                lambda: (
                    any(o.last_uuid == message.uuid for o in self.statuses[-1].options)
                    and self.is_complete()
                ),
                'what was learned from it',
            )
        return receipt

    def give_all(self, demos: list[Demonstration]) -> None:
        """Send demonstrations that must be accepted."""
        for demo in demos:
            receipt = self.give(demonstration_to_message(demo))
            assert receipt.status == ACCEPTED, receipt.detail

    def is_complete(self) -> bool:
        """Return whether all options of the newest status have come."""
        newest = self.statuses[-1].options_sequence
        return bool(self.options) and self.options[-1].sequence >= newest

    def models(self) -> dict[str, str]:
        """Return the newest data of each option."""
        return {o.name: o.model for o in self.options if o.model}

    def known(self) -> dict[str, Any]:
        """Return the newest status by option."""
        return {o.option_name: o for o in self.statuses[-1].options}


@pytest.fixture(scope='module')
def learning(shared: Graph) -> Learning:
    opened = Learning(shared)
    opened.give_all(expert(FETCH, 5))
    return opened


def test_what_is_learned_is_what_the_pure_code_learns(learning: Learning) -> None:
    demos = expert(FETCH, 5)
    status = learning.known()[FETCH]
    judgement = judge(demos, TAXI, Thresholds(), SEED)
    taught = [demo for demo in demos if demo.actions]
    assert (status.n_demonstrations, status.n_not_here) == (len(taught), 5 - len(taught))
    assert status.last_uuid == demos[-1].uuid
    for criterion, expected in zip(status.criteria, judgement.criteria):
        value = math.nan if expected.value is None else expected.value
        assert criterion.name == expected.name
        assert criterion.value == pytest.approx(value, nan_ok=True)
        assert (criterion.measurable, criterion.met) == (expected.measurable, expected.met)
    assert status.criteria_met == judgement.criteria_met
    option, _ = option_from_json(learning.models()[FETCH])
    assert option == learn_option(demos, TAXI, SEED)


def other(demos: list[Demonstration]) -> list[Demonstration]:
    """Return these demonstrations as those of another option."""
    return [replace(demo, option_name='other', uuid=str(uuid4())) for demo in demos]


def test_only_what_changes_is_published_and_a_new_reader_gets_every_option(
    learning: Learning,
) -> None:
    learning.give_all(other(expert(FETCH, 2)))
    before = len(learning.options)
    learning.give_all(other(expert(FETCH, 3)[2:]))
    assert {option.name for option in learning.options[before:]} == {'other'}
    late: list[LearnedOption] = learning.graph.listen(LearnedOption, 'learned_options')
    learning.graph.until(lambda: len(late) == 2, 'every option')
    assert {o.name: o.model for o in late} == learning.models()
    assert {o.n_options for o in late} == {2}


def test_what_is_known_or_cannot_be_used_is_answered_in_words_and_changes_nothing(
    learning: Learning,
) -> None:
    """All that is refused is in test_demonstrations.py of humanopts_learner."""
    statuses, content = len(learning.statuses), (learning.folder / DATA_SET).read_bytes()
    receipt = learning.give(demonstration_to_message(expert(FETCH, 5)[2]))
    assert (receipt.status, receipt.detail) == (receipt.STATUS_DUPLICATE, 'it is known already')
    demo = walk('taxi 0,1 passenger R destination G', ['west', 'pickup'], FETCH, ['taxi_row'])
    for field, value, says in (
        ('rewards', [-1.0, math.nan], 'not finite'),
        ('features', [1.0], '3 states but 1 rows of features'),
        ('actions', ['east', 'pickup'], 'east does not lead'),
        ('kind', 0, 'kind'),
    ):
        message = demonstration_to_message(demo)
        setattr(message, field, value)
        receipt = learning.give(message)
        assert receipt.status == DemonstrationReceipt.STATUS_REFUSED
        assert says in receipt.detail
    assert len(learning.statuses) == statuses
    assert (learning.folder / DATA_SET).read_bytes() == content


def test_a_learner_that_was_killed_knows_everything_again_and_names_what_is_damaged(
    learning: Learning, capfd: pytest.CaptureFixture[str]
) -> None:
    files = {option.name: option for option in load_options(learning.folder)[0]}
    assert files[FETCH] == learn_option(expert(FETCH, 5), TAXI, SEED)
    nothing = walk('taxi 0,0 passenger aboard destination G', [], 'another', ['taxi_row'])
    learning.give_all([nothing])
    before, models = str(learning.known()), learning.models()
    # All that a process leaves that is killed now; test_node_deaths.py kills one.
    learning.folder = Path(shutil.copytree(learning.folder, learning.folder.with_name('left')))
    learning.graph.stop(learning.node)
    data = learning.folder / DATA_SET
    first, rest = data.read_bytes().split(b'\n', 1)
    foreign = first.replace(b'"rows\\": 5', b'"rows\\": 9')
    assert foreign != first
    whole = b'{}\n' + foreign + b'\n' + first + b'\n' + rest
    data.write_bytes(whole + b'{"kind": "traj')
    capfd.readouterr()
    learning.options.clear()
    learning.node = learning.start()
    said = capfd.readouterr().err
    assert ['was cut off' in said, 'line 3 of' in said] == [True, False]
    assert 'line 1 of' in said
    assert 'line 2 of' in said
    assert (str(learning.known()), learning.models()) == (before, models)
    assert data.read_bytes() == whole
    assert learning.give(demonstration_to_message(nothing)).status == (
        DemonstrationReceipt.STATUS_DUPLICATE
    )
