"""Gymnasium environments without a table are replayed; features are observed or extracted."""

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.testing import DomainContract


class TestLunarLander(DomainContract):
    def make(self) -> Domain:
        return make_domain('gymnasium:LunarLander-v3')


class TestDoorKey(DomainContract):
    def make(self) -> Domain:
        return make_domain('gymnasium:MiniGrid-DoorKey-8x8-v0')


class TestKeyCorridor(DomainContract):
    def make(self) -> Domain:
        return make_domain('gymnasium:MiniGrid-KeyCorridorS3R2-v0')
