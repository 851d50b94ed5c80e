"""Decision trees as human-readable rules."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

from humanopts_env.domains.base import Domain, FeatureKind
from humanopts_env.domains.formulas import feature_columns, plain_name
from humanopts_learner.options.decision_tree import EncodedFeature, LEAF, Tree
from humanopts_learner.options.learned_option import LearnedOption

MEMBERS = {'initiation': ('cannot start', 'can start'), 'termination': ('goes on', 'ends')}
LINES_SHOWN_OPEN = 60


@dataclass(frozen=True)
class TreeRules:
    """One tree, formatted for the page."""

    part: str  # initiation, termination or policy
    depth: int
    leaves: int
    examples: int
    text: str
    open: bool


def option_rules(option: LearnedOption, domain: Domain) -> list[TreeRules]:
    """Return the three trees of an option, with the policy last."""
    trees: dict[str, tuple[Tree, Sequence[str], Sequence[EncodedFeature]]] = {
        'initiation': (option.initiation, MEMBERS['initiation'], option.encoding),
        'termination': (option.termination, MEMBERS['termination'], option.encoding),
        'policy': (option.policy, option.actions, option.policy_encoding),
    }
    found = []
    for part, (tree, classes, encoding) in trees.items():
        lines = tree_lines(tree, classes, encoding, domain)
        if (count := len(tree.roots)) > 1:
            lines = [f'the first of {count} trees, whose shares are averaged:', *lines]
        leaves, examples = int((tree.left == LEAF).sum()), int(tree.counts[0].sum())
        is_open = part != 'policy' and len(lines) <= LINES_SHOWN_OPEN
        found.append(TreeRules(part, tree.depth, leaves, examples, '\n'.join(lines), is_open))
    return found


def tree_lines(
    tree: Tree, classes: Sequence[str], encoding: Sequence[EncodedFeature], domain: Domain
) -> list[str]:
    """
    Return the tree as indented lines, one per branch.

    :param classes: name of each class, (K,).
    :param encoding: encoding of the features used by the tree.
    """

    def below(node: int, indent: str) -> list[str]:
        if tree.left[node] == LEAF:
            return [indent + _leaf(tree, node, classes)]
        column, threshold = encoding[tree.feature[node]], float(tree.threshold[node])
        lines = []
        children = tree.right[node], tree.left[node]
        for child, words in zip(children, _test(column, threshold, domain)):
            inner = below(int(child), indent + '    ')
            if len(inner) == 1:
                lines.append(f'{indent}{words}: {inner[0].strip()}')
            else:
                lines += [f'{indent}{words}:', *inner]
        return lines

    return below(0, '')


def _test(column: EncodedFeature, threshold: float, domain: Domain) -> tuple[str, str]:
    """Return a test in words: for the right branch (above the threshold) and the left one."""
    name = plain_name(column.feature)
    feature = feature_columns(domain, [column.feature])[0].feature
    values = feature.values
    if column.value is not None:
        value = values[column.value]
        opposite = values[1 - column.value] if len(values) == 2 else f'not {value}'
        return f'{name} is {value}', f'{name} is {opposite}'
    if feature.kind is FeatureKind.CONTINUOUS:
        return f'{name} > {feature.text(threshold)}', f'{name} ≤ {feature.text(threshold)}'
    highest = math.floor(threshold)
    return f'{name} ≥ {values[highest + 1]}', f'{name} ≤ {values[highest]}'


def _leaf(tree: Tree, node: int, classes: Sequence[str]) -> str:
    counts = tree.counts[node]
    best, total = int(counts.argmax()), int(counts.sum())
    share = f'{total}' if counts[best] == total else f'{counts[best]} of {total}'
    return f'{classes[best]} ({share})'
