"""Memory that threads share: nobody takes more than there is beside another, and who needs all gets it alone."""

from __future__ import annotations

import random
import threading

from geomosaic.render.photos import MemoryBudget


def test_no_more_is_held_than_there_is_but_by_one_alone() -> None:
    budget, lock = MemoryBudget(100), threading.Lock()
    held: list[int] = []
    most: list[tuple[int, int]] = []

    def work(sizes: list[int]) -> None:
        for size in sizes:
            with budget.reserve(size):
                with lock:
                    held.append(size)
                    most.append((sum(held), len(held)))
                with lock:
                    held.remove(size)

    chance = random.Random(4)
    threads = [
        threading.Thread(target=work, args=([chance.choice((10, 40, 70, 250)) for _ in range(200)],)) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert not any(thread.is_alive() for thread in threads)
    assert len(most) == 800
    assert all(total <= 100 or alone == 1 for total, alone in most)
    assert any(total > 100 for total, _ in most)


def test_room_is_given_back_where_the_work_fails() -> None:
    budget = MemoryBudget(10)
    for _ in range(2):
        try:
            with budget.reserve(10):
                raise ValueError
        except ValueError:
            continue
    with budget.reserve(10):
        pass
