"""What ``option_server`` receives of the policy that ``planner`` runs: values and execution."""

from operator import is_

from humanopts_interfaces.msg import ExecutionState, OptionValues
from humanopts_learner.execution import Arbiter, execution_named, RunError
from humanopts_learner.library import OptionLibrary, RunnableOption
from humanopts_learner.planning.interruption import OptionValues as PlanValues
from humanopts_learner.planning.request import Execution
from humanopts_learner.ros.convert import option_values_from_message
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT


class PolicySubscriber:
    """Keeps the newest option values and execution, and makes arbiters of them."""

    def __init__(self, node: NodeBase) -> None:
        self._node = node
        self._message: OptionValues | None = None
        self._values: PlanValues | None = None  # of the message
        self._state: ExecutionState | None = None
        self._arbiters: dict[Execution, Arbiter] = {}  # of the newest values, for these options
        self._options: dict[str, RunnableOption] = {}
        node.subscribe(OptionValues, 'option_values', _read_values, self._on_values, CURRENT)
        node.subscribe(ExecutionState, 'execution', _checked, self._on_execution, CURRENT)

    def has(self, plan_id: str) -> bool:
        """Return whether the values of a plan are the newest."""
        return self._message is not None and self._message.plan_id == plan_id

    def newest(self) -> str:
        """Return in words which plan the newest values belong to."""
        if self._message is None:
            return 'none came yet'
        return f'the newest are those of {self._message.plan_id}'

    def arbiter(self, execution: Execution, library: OptionLibrary) -> Arbiter:
        """
        Return the arbiter of the newest values.

        :raises UnknownOptionError: an option of the plan is not in the library.
        :raises ValueError: the values do not fit the options or their domain.
        """
        assert self._message is not None
        assert self._values is not None
        who, names = self._message.participant, [*self._message.names, *library.primitive_names]
        options = {name: library.resolve(name, who) for name in names}
        if not all(map(is_, options.values(), self._options.values())):
            self._arbiters = {}  # options were taught anew
        self._options = options
        if execution not in self._arbiters:
            self._arbiters[execution] = Arbiter(self._values, execution, library.domain, options)
        return self._arbiters[execution]

    def wanted(self, execution: Execution, sequence: int, plan_id: str) -> Execution:
        """
        Return the execution that is in force for a run.

        :param execution: the execution in the request of the run.
        :param sequence: of the ExecutionState of the request; 0: the execution never changes.
        """
        state = self._state
        newer = state is not None and 0 < sequence < state.sequence
        if state is None or not newer or state.plan_id != plan_id:
            return execution
        return Execution(state.execution)

    def canceled(self, sequence: int) -> bool:
        """Return whether the policy run of a run is to end; ``sequence`` as in ``wanted``."""
        state = self._state
        return state is not None and 0 < sequence < state.sequence and state.canceled

    def _on_values(self, read: tuple[OptionValues, PlanValues]) -> None:
        (self._message, self._values), self._arbiters = read, {}
        self._node.waiting.check()

    def _on_execution(self, message: ExecutionState) -> None:
        self._state = message


def _read_values(message: OptionValues) -> tuple[OptionValues, PlanValues]:
    """
    Return the message and its values.

    :raises PlanError: the parts contradict each other.
    """
    return message, option_values_from_message(message)


def _checked(message: ExecutionState) -> ExecutionState:
    """
    Return the message.

    :raises ValueError: its execution does not exist.
    """
    try:
        execution_named(message.execution)
    except RunError as error:
        raise ValueError(str(error)) from None
    return message
