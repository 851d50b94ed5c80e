"""The lease of control: renewed by its holder, and over when that is silent."""

from humanopts_env.lease import CHECKS, Lease, MOST_KNOWN

ANNA, AGAIN, BERT = '/anna#1', '/anna#2', '/bert#1'


def leased(*known: str) -> Lease:
    """A lease of Anna, where publishers have told their life."""
    lease = Lease()
    for publisher in known:
        lease.note_status(publisher)
    lease.begin(ANNA)
    return lease


def looks(lease: Lease, count: int) -> list[str]:
    return [lease.check() for _ in range(count)]


def test_it_ends_after_so_many_looks_without_a_sign() -> None:
    *before, last = looks(leased(ANNA), CHECKS)
    assert not any(before)
    assert last == '/anna#1 is silent, and has not renewed its control'


def test_whatever_the_holder_publishes_renews_it_and_nobody_else() -> None:
    lease = leased(ANNA, BERT)
    for renew in (lease.renew, lease.note_status):
        assert not any(looks(lease, CHECKS - 1))
        renew(ANNA)
        assert not any(looks(lease, CHECKS - 1))
        renew(BERT)
        assert lease.check() != ''
        lease.begin(ANNA)


def test_a_holder_that_is_started_again_or_ends_loses_it_at_once() -> None:
    assert leased(ANNA).note_status(AGAIN) == '/anna was started again'
    assert leased(ANNA).note_status(ANNA, ended=True) == '/anna#1 has ended'
    assert not leased(ANNA).note_status(BERT)
    assert not leased(ANNA).note_status(BERT, ended=True)
    assert not leased(ANNA, AGAIN).note_status(AGAIN)  # two that both were there before


def test_nobody_can_lose_it() -> None:
    lease = Lease()
    assert not any(looks(lease, 3 * CHECKS))
    assert not lease.note_status(ANNA)
    assert not lease.note_status(ANNA, ended=True)


def test_who_told_its_life_is_known_until_it_ends_and_not_more_than_memory_allows() -> None:
    lease = leased(ANNA)
    assert (lease.knows(ANNA), lease.knows(BERT)) == (True, False)
    lease.note_status(ANNA, ended=True)
    assert not lease.knows(ANNA)
    for number in range(MOST_KNOWN + 1):
        lease.note_status(f'/many#{number}')
    assert not lease.knows('/many#0')
    assert lease.knows('/many#1')
