"""The leaf of the example in behaviour trees, and the tree for BehaviorTree.CPP."""

from collections.abc import Iterator
import importlib
import os
from pathlib import Path
import re
import subprocess
import sys
from typing import Any
from xml.etree import ElementTree

from graph_support.live import GAME, Graph, open_graph, OPTION_SERVER
from graph_support.player import Player
from graph_support.scripted import DELIVER, FETCH, taught
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import OptionResult
from humanopts_interfaces.srv import SetPace
from humanopts_learner.options.files import save_option
from py_trees.common import Status
from py_trees.trees import BehaviourTree
import pytest

EXAMPLE = Path(__file__).parents[1] / 'examples/behaviour_trees'
sys.path.insert(0, str(EXAMPLE))
Leaf: Any = importlib.import_module('execute_option').ExecuteOption
START = 'taxi 4,4 passenger R destination G'


class Forest:
    """A game, an option server, and trees that use it."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.player = graph, Player(graph)
        self.results: list[OptionResult] = graph.listen(OptionResult, 'option_results')

    def plant(self, leaf: Any, start: str = START) -> BehaviourTree:
        """Begin an episode, and set up a tree of one leaf."""
        self.player.fresh(start)
        tree = BehaviourTree(leaf)
        tree.setup(node=self.graph.node)
        return tree

    def grow(self, tree: BehaviourTree, *until: Status) -> Status:
        """Tick until the root has one of these statuses."""

        def reached() -> bool:
            tree.tick()
            return tree.root.status in until

        self.graph.until(reached, f'{until}')
        return tree.root.status

    def pace(self, seconds: float) -> None:
        """Slow the machine down."""
        assert self.graph.ask(SetPace, 'set_pace', step_period=seconds).status == 1


@pytest.fixture(scope='module')
def forest(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forest]:
    folder = tmp_path_factory.mktemp('options')
    for option in taught():
        save_option(folder, option, [])
    with open_graph(tmp_path_factory.mktemp('forest')) as graph:
        graph.start(GAME)
        graph.start(OPTION_SERVER, options_directory=folder)
        graph.ready('/game', '/option_server')
        yield Forest(graph)


def test_the_leaf_runs_an_option_to_its_end(forest: Forest) -> None:
    leaf = Leaf(FETCH)
    tree = forest.plant(leaf)
    tree.tick()
    assert leaf.status is Status.RUNNING
    assert forest.grow(tree, Status.SUCCESS, Status.FAILURE) is Status.SUCCESS
    assert 'passenger aboard' in forest.player.state.state
    assert leaf.feedback_message == 'its termination condition holds'


def test_the_leaf_fails_where_the_option_cannot_start(forest: Forest) -> None:
    leaf = Leaf(DELIVER)
    assert forest.grow(forest.plant(leaf), Status.SUCCESS, Status.FAILURE) is Status.FAILURE
    assert leaf.feedback_message
    unknown = Leaf('fly')
    assert forest.grow(forest.plant(unknown), Status.SUCCESS, Status.FAILURE) is Status.FAILURE


def test_a_halted_leaf_cancels_its_run(forest: Forest) -> None:
    forest.pace(0.1)
    tree, known = forest.plant(Leaf(FETCH)), len(forest.results)
    forest.grow(tree, Status.RUNNING)
    forest.graph.until(lambda: tree.tick() or forest.player.state.step >= 1, 'a step')
    tree.root.stop(Status.INVALID)
    forest.graph.until(lambda: len(forest.results) > known, 'the end of the run')
    assert forest.results[-1].status == OptionResult.STATUS_CANCELED
    assert forest.grow(tree, Status.SUCCESS) is Status.SUCCESS, 'the same leaf runs again'
    forest.pace(0.0)


def test_a_leaf_preempts_the_run_of_another(forest: Forest) -> None:
    forest.pace(0.1)
    first, known = forest.plant(Leaf(FETCH)), len(forest.results)
    forest.graph.until(lambda: first.tick() or forest.player.state.step >= 1, 'a step')
    busy = BehaviourTree(Leaf(FETCH, preempt=False))
    busy.setup(node=forest.graph.node)
    assert forest.grow(busy, Status.SUCCESS, Status.FAILURE) is Status.FAILURE
    second = BehaviourTree(Leaf(FETCH))
    second.setup(node=forest.graph.node)
    forest.pace(0.0)
    assert forest.grow(second, Status.SUCCESS, Status.FAILURE) is Status.SUCCESS
    assert forest.grow(first, Status.SUCCESS, Status.FAILURE) is Status.FAILURE
    assert OptionResult.STATUS_INTERRUPTED in {r.status for r in forest.results[known:]}


def test_the_tree_of_the_example_plays_taxi(forest: Forest) -> None:
    forest.player.fresh(START)
    tree = subprocess.Popen(
        [sys.executable, EXAMPLE / 'taxi_tree.py'],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, 'ROS_DOMAIN_ID': str(forest.graph.domain_id)},
    )
    forest.graph.until(lambda: tree.poll() is not None, 'the end of the tree', 60.0)
    assert forest.player.state.terminated
    assert tree.stdout is not None
    assert re.search(r'deliver \[✓\]', tree.stdout.read())


def test_the_xml_names_fields_of_the_action() -> None:
    root = ElementTree.parse(EXAMPLE / 'taxi.xml').getroot()
    trees = {each.get('ID') for each in root.iter('BehaviorTree')}
    assert root.get('main_tree_to_execute') in trees
    (model,) = root.iter('Action')
    ports = {each.get('name') for each in model}
    fields = set(ExecuteOption.Goal.get_fields_and_field_types())
    assert ports - {'action_name', 'detail'} <= fields
    leaves = [*root.iter('ExecuteOption')]
    assert [leaf.get('option_name') for leaf in leaves] == [FETCH, DELIVER]
    assert all(set(leaf.keys()) <= ports for leaf in leaves)
    code = (EXAMPLE / 'README.md').read_text()
    assert set(re.findall(r'putPort<[\w:]+>\("(\w+)"', code)) == ports - {'action_name'}
