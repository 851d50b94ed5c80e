"""What can be wrong with a request to plan."""


class PlanError(ValueError):
    """A plan cannot be made; the text says why."""


class ModelError(PlanError):
    """The arrays of a model contradict each other, or a limit makes no sense."""


class GammaError(PlanError):
    """The discount is not in (0, 1]."""


class UnknownActionSetError(PlanError):
    """There is no such action set."""


class NoOptionsError(PlanError):
    """The action set names options and there are none."""


class DuplicateOptionError(PlanError):
    """Two options have the same name."""


class ForeignOptionError(PlanError):
    """An option belongs to another domain."""


class NotEnumerableError(PlanError):
    """The states of the domain cannot all be listed."""


class NotDeterministicError(PlanError):
    """An action of the domain has more than one outcome."""


class PlanCanceled(Exception):  # noqa: N818 - no error: raised by a progress callback to stop
    """Planning was canceled."""


def check_gamma(gamma: float) -> None:
    """
    Check a discount.

    :raises GammaError: it is not in (0, 1].
    """
    if not 0.0 < gamma <= 1.0:
        raise GammaError(f'gamma is {gamma}, and must be above 0 and at most 1')


def check_limits(tol: float, max_sweeps: int) -> None:
    """
    Check where sweeps are to end.

    :raises ModelError: tol is negative or no number, or max_sweeps is below 1.
    """
    if not tol >= 0.0 or max_sweeps < 1:
        raise ModelError(f'tol is {tol} and max_sweeps {max_sweeps}: need tol >= 0 and a sweep')
