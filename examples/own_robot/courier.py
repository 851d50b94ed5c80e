"""
A courier in a street: a robot that is taught like ``rover``.

Batteries are changed at the west end of the street. Neither *deliver* nor *charge* depends on the
battery, but the choice between them does. No other node knows the rules, which are in
``street.py``.
"""

from humanopts_interfaces.msg import ActionInfo, DomainInfo, FeatureInfo
from rover import main, Robot
from street import ACTIONS, FEATURES, FULL, GAMMA, MAX_STEPS, Street


class Courier(Robot):
    """A courier in a street."""

    def __init__(self) -> None:
        info = DomainInfo(domain='street', parameters='{}', gamma=GAMMA, max_steps=MAX_STEPS)
        info.features = [
            FeatureInfo(
                name=name,
                question=question,
                kind=FeatureInfo.KIND_NOMINAL if values else FeatureInfo.KIND_CONTINUOUS,
                value_names=values,
                unit='' if values else '%',
                high=0.0 if values else FULL,
            )
            for name, (question, values) in FEATURES.items()
        ]
        info.actions = [
            ActionInfo(name=name, key=key, description=text)
            for name, (key, text) in ACTIONS.items()
        ]
        super().__init__(info)
        self._street = Street()

    def carry(self, seed: int) -> None:
        self._street.reset(seed)

    def execute(self, action: str, step: int) -> dict[str, float | bool]:
        reward, street = self._street.step(action), self._street
        return {'reward': reward, 'terminated': street.empty, 'truncated': street.cut_off}

    def sense(self) -> list[float]:
        return self._street.features()


if __name__ == '__main__':
    main(Courier)
