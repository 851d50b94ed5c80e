"""Publishing and subscribing to options, with one message per changed option."""

from collections.abc import Callable, Mapping

from humanopts_interfaces.msg import LearnedOption as OptionMessage
from humanopts_learner.options.files import option_from_json
from humanopts_learner.options.learned_option import LearnedOption, OptionError
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import STREAM

_GATHERING = 0.1  # delay of publishing in s, to serve several new subscribers together
_MAX_LIVES = 4  # maximum number of publisher_ids with stored options
Key = tuple[str, str]  # participant and name of an option


class OptionPublisher:
    """
    Publishes changed options, and all options for each new subscriber.

    :ivar sequence: sequence number of the last message; 0: none sent.
    """

    def __init__(self, node: NodeBase, topic: str) -> None:
        """Create the publisher."""
        self._files: Mapping[Key, str] | None = None
        self._sent: dict[Key, str] = {}
        self._timer = node.create_timer(_GATHERING, self._publish_again, autostart=False)
        self._publisher = node.stamped_publisher(
            OptionMessage, topic, STREAM, lambda _: self._timer.reset()
        )

    @property
    def sequence(self) -> int:
        """Sequence number of the last message; 0: none sent."""
        return self._publisher.sequence

    def publish(self, files: Mapping[Key, str]) -> None:
        """
        Publish the changes since the last call.

        :param files: contents of all option files; missing options were removed.
        :raises PublishError: a message could not be sent; the next call retries.
        """
        first, self._files = self._files is None, dict(files)
        for key in [*(self._sent.keys() - files.keys()), *files]:
            if files.get(key) != self._sent.get(key):
                self._send(key)
        if first and not files:
            self._send(('', ''))

    def _publish_again(self) -> None:
        self._timer.cancel()
        if self._files is not None:
            for key in self._files or [('', '')]:
                self._send(key)

    def _send(self, key: Key) -> None:
        files = self._files or {}
        (participant, name), model = key, files.get(key, '')
        self._publisher.publish(
            OptionMessage(name=name, participant=participant, model=model, n_options=len(files))
        )
        if model:
            self._sent[key] = model
        else:
            self._sent.pop(key, None)


class OptionSubscriber:
    """Receives the options of a topic, and reports them once all have arrived."""

    def __init__(
        self,
        node: NodeBase,
        topic: str,
        use: Callable[[list[LearnedOption], OptionMessage], object],
    ) -> None:
        """
        Subscribe.

        :param use: called with the options, in a new list if any of them has changed, and the
            message that completed them.
        """
        self._node, self._topic, self._use = node, topic, use
        # By publisher_id, so that messages of one publisher cannot replace options of another;
        # None: the option is unreadable.
        self._lives: dict[str, dict[Key, LearnedOption | None]] = {}
        self._options: list[LearnedOption] = []
        node.create_subscription(OptionMessage, topic, self._read, STREAM)

    def _read(self, message: OptionMessage) -> None:
        known = self._lives.pop(message.publisher_id, {})
        self._lives[message.publisher_id] = known  # move to the end
        if len(self._lives) > _MAX_LIVES:
            del self._lives[next(iter(self._lives))]
        key = message.participant, message.name
        if message.model:
            try:
                known[key] = option_from_json(message.model)[0]
            except OptionError as error:
                known[key] = None
                self._node.refuse(self._topic, message, f'{message.name!r}: {error}')
        else:
            known.pop(key, None)
        if len(known) == message.n_options:
            if (options := [o for o in known.values() if o is not None]) != self._options:
                self._options = options
            self._use(self._options, message)
