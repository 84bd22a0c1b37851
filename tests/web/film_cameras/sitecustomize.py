"""Films in place of cameras by number, in this process and those that it starts.

With this folder on PYTHONPATH, ``cv2.VideoCapture(N)`` reads the film that FILM_CAMERAS, a JSON object, names for N.
Nothing else changes: names of files go to OpenCV, and numbers without a film are cameras that do not exist.
"""

import json
import os
import time

import cv2

FILMS = {int(number): film for number, film in json.loads(os.environ.get("FILM_CAMERAS", "{}")).items()}
RATE_HZ = 10.0
open_video = cv2.VideoCapture


class FilmCamera:
    """A film as a camera gives it: ten images a second, from the start again at its end, and no time of its own."""

    def __init__(self, film):
        self._film = open_video(film)
        self._next_s = time.monotonic()

    def isOpened(self):
        return self._film.isOpened()

    def grab(self):
        time.sleep(max(0.0, self._next_s - time.monotonic()))
        self._next_s = time.monotonic() + 1 / RATE_HZ
        if self._film.grab():
            return True
        self._film.set(cv2.CAP_PROP_POS_FRAMES, 0)
        return self._film.grab()

    def retrieve(self):
        return self._film.retrieve()

    def read(self):
        return self.retrieve() if self.grab() else (False, None)

    def get(self, key):
        return RATE_HZ if key == cv2.CAP_PROP_FPS else 0.0

    def set(self, key, value):
        return False

    def release(self):
        self._film.release()


def open_capture(target, *options):
    """In place of ``cv2.VideoCapture``."""
    return FilmCamera(FILMS[target]) if target in FILMS else open_video(target, *options)


cv2.VideoCapture = open_capture
