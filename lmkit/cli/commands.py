"""Names and summaries of the commands, and the list of them that `lmkit --help` prints, without typer.

Importing typer takes three times as long as the rest of `lmkit --help`.
"""

from __future__ import annotations

HELP = "Printed landmarks for robots: from print to pose."
VERSION_HELP = "Print the version and exit."
DEBUG_HELP = "Print a traceback on errors."
OPTIONS = {"--version": VERSION_HELP, "--debug": DEBUG_HELP, "-h, --help": "Show this message and exit."}

# Each is a module of this folder with a function `run`, or a typer app for a group of commands.  The summaries are
# repeated from the modules, so that the list of commands imports none of them; a test compares both.
COMMANDS = {
    "generate": "Write printable landmarks, true to scale.",
    "board": "Write a calibration board, true to scale.",
    "verify": "Read prints back and grade them from A to F.",
    "detect": "Find and read landmarks in images and videos.",
    "calibrate": "Calibrate cameras from images of a board.",
    "rectify": "Rectify stereo pairs.",
    "convert": "Convert rigs, maps and trajectories.",
    "map": "Make a map from tape measurements; check and draw it.",
    "locate": "Locate the camera, or the robot, in the map.",
    "survey": "Build the landmark map from a recording.",
    "track": "Track the robot through a known map.",
    "run": "Publish the pose of a robot while it drives.",
    "plan": "Plan landmark positions, accuracy and routes.",
    "evaluate": "Compute the errors of a trajectory, as evo does.",
    "unbag": "Extract stereo images, rig, odometry and gyro from a ROS bag.",
    "web": "Serve lmkit as a page in the browser.",
    "fleet": "Map a site from the recordings of many robots.",
    "simulate": "Simulate a room and a stereo camera.",
    "demo": "Run all steps in a simulated room.",
    "doctor": "Check the installation.",
}


def list_of_commands() -> str:
    """The text of `lmkit --help`, as typer prints it."""
    return "\n".join(
        [
            "Usage: lmkit [OPTIONS] COMMAND [ARGS]...",
            "",
            f"  {HELP}",
            "",
            "Options:",
            *_rows(OPTIONS),
            "",
            "Commands:",
            *_rows(COMMANDS),
        ]
    )


def _rows(texts: dict[str, str]) -> list[str]:
    width = max(map(len, texts))
    return [f"  {name:{width}}  {text}" for name, text in texts.items()]
