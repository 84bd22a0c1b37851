"""The simulated recording: its sensors compared with its truth."""

import numpy as np

from lmkit.simulation.recording import WheelErrors, make_drive


def test_a_gyro_without_errors_turns_as_the_robot_does():
    errors = WheelErrors(delay_s=0.0, gyro_bias=0.0, gyro_noise=0.0)
    made = make_drive(3, seconds=20, hz=5, count=0, errors=errors, eights=True)
    turned = made.gyro.turned(made.times_s)
    # Half a step late: 0.4 mrad between frames.
    assert np.abs(np.diff(turned) - np.diff(made.truth[:, 2])).max() < 1e-4
    assert np.abs((turned - turned[0]) - (made.truth[:, 2] - made.truth[0, 2])).max() < 1e-4
