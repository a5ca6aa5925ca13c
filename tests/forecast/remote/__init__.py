"""Calls that are made in a process of their own."""

import os
import time

import numpy as np

from replay_kit.core.errors import ForecastError
from replay_kit.core.words.progress import announce


def announces(word):
    for k in range(3):
        announce(word, k, 3)
        time.sleep(0.25)
    return word.upper()


def hangs():
    time.sleep(60.0)


def dies():
    os._exit(3)


def refuses():
    raise ForecastError("no such sea")


def takes_all():
    held = []
    while True:
        held.append(np.empty(1 << 26))
