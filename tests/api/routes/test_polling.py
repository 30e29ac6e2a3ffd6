"""Requests that wait for a change."""

import asyncio

from api.routes.polling import looks


async def counted(seconds):
    return [number async for number in looks(seconds)]


def test_without_time_to_wait_there_is_one_look():
    assert asyncio.run(counted(0.0)) == [0]


def test_looks_go_on_until_the_time_is_over_and_the_last_follows_it():
    assert asyncio.run(counted(0.3)) == [0, 1, 2]
