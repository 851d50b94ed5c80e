"""The node ``learner``, which fits and evaluates an option after every demonstration."""

from functools import partial
from pathlib import Path
import sys
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.ros.game_subscriber import GameSubscriber
from humanopts_interfaces.msg import Demonstration, DemonstrationReceipt, LearningStatus
from humanopts_learner.demonstrations import demonstration_from_message, DemonstrationError
from humanopts_learner.option_trainer import DataSetError, OptionTrainer
from humanopts_learner.options.judge import Thresholds
from humanopts_learner.ros import LEARNER
from humanopts_learner.ros.convert import summary_to_message
from humanopts_learner.ros.learned_options import OptionPublisher
from humanopts_ros.guarded_node import SEEDS, StartError
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import LATCHED, STREAM


class LearnerNode(NodeBase):
    """Stores demonstrations, and publishes the options learned from them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(LEARNER, **options)
        self._directory = Path(
            self.setting('directory', 'options', 'folder of option files and of the data set')
        )
        self._seed = self.setting('seed', 0, 'seed of all random draws', SEEDS)
        self._thresholds = self.settings(
            Thresholds(),
            {
                'success': 'smallest share of starts that lead to an end like a demonstrated one',
                'return_share': 'largest shortfall of the return, as a share of its range',
                'initiation_error': 'largest balanced error of I',
                'termination_error': 'largest share of demonstrations with another end',
                'exam': 'runs of an option in its first exam; 0: no exam',
            },
            {
                'success': (0.0, 1.0),
                'return_share': (0.0, 1.0),
                'initiation_error': (0.0, 1.0),
                'termination_error': (0.0, 1.0),
                'exam': (0, 1_000_000),
            },
        )
        self._trainer: OptionTrainer | None = None
        self._receipts = self.stamped_publisher(DemonstrationReceipt, 'demonstration_receipts')
        self._status_out = self.stamped_publisher(LearningStatus, 'learning_status', LATCHED)
        self._options_out = OptionPublisher(self, 'learned_options')
        GameSubscriber(self, self._on_domain)
        self.create_subscription(Demonstration, 'demonstrations', self._on_demonstration, STREAM)

    def waits_for(self) -> str | None:
        return None if self._trainer else 'domain_info'

    def on_ready(self) -> None:
        """Publish the options from earlier sessions."""
        if self._trainer is not None:
            self._publish(self._trainer)

    def _on_domain(self, domain: ActableDomain) -> None:
        try:
            self._trainer = OptionTrainer(self._directory, domain, self._thresholds, self._seed)
        except DataSetError as error:
            raise StartError(str(error)) from error
        self._log_problems(self._trainer)

    def _on_demonstration(self, message: Demonstration) -> None:
        name = shown(message.option_name)
        receipt = DemonstrationReceipt(uuid=shown(message.uuid), option_name=name)
        try:
            if self._trainer is None:
                raise DataSetError('the learner does not know the game yet')
            if self._trainer.take(demonstration_from_message(message)):
                receipt.status = receipt.STATUS_ACCEPTED
                self._log_problems(self._trainer)
                self._publish(self._trainer)
                self._log_learned(self._trainer, message)
            else:
                receipt.status, receipt.detail = receipt.STATUS_DUPLICATE, 'it is known already'
        except DemonstrationError as error:
            receipt.status, receipt.detail = receipt.STATUS_REFUSED, shown(str(error))
            self.refuse('demonstrations', message, error)
        except DataSetError as error:
            receipt.status, receipt.detail = receipt.STATUS_REFUSED, str(error)
        except Exception as error:  # unexpected, but the lesson is waiting for a receipt
            receipt.status = receipt.STATUS_REFUSED
            receipt.detail = self.guard.caught('learning', error)
        self._receipts.publish(receipt)

    def _log_problems(self, trainer: OptionTrainer) -> None:
        """Log errors in the folder that are new since the last call."""
        while trainer.problems:
            self.get_logger().warning(trainer.problems.pop(0))

    def _log_learned(self, trainer: OptionTrainer, message: Demonstration) -> None:
        """Log the learning progress of a demonstration's option."""
        for each in trainer.options():
            summary = each.summary
            if (summary.participant, summary.option_name) == (
                message.participant,
                message.option_name,
            ):
                self.get_logger().info(f'{shown(summary.option_name)}: {summary.status}')

    def _publish(self, trainer: OptionTrainer) -> None:
        options = trainer.options()
        self._options_out.publish(
            {(o.summary.participant, o.summary.option_name): o.file for o in options if o.file}
        )
        self._status_out.publish(
            LearningStatus(
                options=[summary_to_message(o.summary) for o in options],
                options_sequence=self._options_out.sequence,
            )
        )


main = partial(run_node, LearnerNode)

if __name__ == '__main__':
    sys.exit(main())
