"""Jobs by verb: each is a command line of lmkit over files of the project."""

from __future__ import annotations

import importlib.util
import json
import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

import lmkit as lm
from lmkit.errors import InputError
from lmkit.units import parse_length_mm
from lmkit.web.answers import Body, answer, read_body
from lmkit.web.project import FILMS, Project, listing
from lmkit.web.state import state_of
from lmkit.web.versions import keep_versions

CAMERA = re.compile(r"camera:[0-9]{1,2}")
EXAMPLE = "drives/example"
DEPTHS = (1.0, 2.0, 4.0, 8.0)
Name = Annotated[str, Field(max_length=300)]
Short = Annotated[str, Field(max_length=80)]


class JobBody(Body):
    """Options of all verbs; each verb uses its own."""

    source: Name = ""
    second: Name = ""
    board: Short = ""
    size: Short = "180mm"
    anchor: bool = True
    walls: Annotated[tuple[Short, ...], Field(max_length=50)] = ()
    heights: Annotated[tuple[Short, ...], Field(max_length=50)] = ()
    live: bool = False
    record: bool = False
    error: Short = "5cm"
    camera_height: Short = ""
    until_mm: Annotated[float, Field(gt=0, le=1000)] = 5.0
    at_m: float = 2.0


@dataclass(frozen=True)
class Plan:
    """Commands of a job, and the files that it writes and replaces."""

    title: str
    steps: tuple[tuple[str, ...], ...]
    command: str
    outputs: tuple[str, ...] = ()
    save_json: str | None = None
    replaces: tuple[str, ...] = ()
    is_live: bool = False
    can_finish: bool = False


async def start(request: Request) -> Response:
    """Start a job."""
    state, body, verb = state_of(request), await read_body(request, JobBody), request.path_params["verb"]
    if verb not in VERBS:
        raise InputError("no_job", f"there is no job {verb[:20]!r}", f"known: {', '.join(VERBS)}")
    plan = VERBS[verb](state.project, body)
    if plan.replaces:
        keep_versions(state.project, *plan.replaces)
    for name in plan.outputs:
        state.project.path(name).parent.mkdir(parents=True, exist_ok=True)
    saved = None if plan.save_json is None else state.project.path(plan.save_json)
    on_line = state.live.publish_line if plan.is_live else None
    wish = (lambda: b"1\n" if state.live.watched else b"0\n") if plan.is_live else None
    job = state.jobs.start(
        verb, plan.title, plan.steps, plan.command, plan.outputs, saved, on_line, wish, plan.can_finish
    )
    return answer(job.as_dict())


def plan_example(project: Project, body: JobBody) -> Plan:
    """A simulated room as files, to try every page."""
    code = f"import lmkit; lmkit.write_example_files({EXAMPLE!r}, board_pairs=12, overwrite=True)"
    return Plan("Write the example", (("-c", code),), f"python -c {shlex.quote(code)}")


def plan_unbag(project: Project, body: JobBody) -> Plan:
    """A recording from a bag, in a folder of its own under ``drives/``."""
    if not any(bag["name"] == body.source for bag in listing(project)["bags"]):
        raise InputError(
            "no_bag", f"there is no bag {body.source[:80]!r}", "put a .bag or .mcap file into the project"
        )
    stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(body.source).stem).strip("-")[:60] or "bag"
    words = ["unbag", body.source, "-o", project.unused("drives", stem, "")]
    return _one_command(f"Unpack {body.source}", words)


def plan_survey(project: Project, body: JobBody) -> Plan:
    """The map from a recording."""
    parse_length_mm(body.size, "size")
    found = _recording(project, body.source)
    stem = _stem(body.source)
    words = ["survey", *_images(found), "--rig", _of(project, found, "rig")]
    anchor = "map.yaml" if (project.root / "map.yaml").is_file() else f"{body.source}/map.yaml"
    if (project.root / "pins.yaml").is_file():
        words += ["--known", "pins.yaml"]
    elif body.anchor and project.path(anchor).is_file():
        words += ["--known", anchor, "--known-sigma", "20mm,2deg"]
    words += [*_motion(found), "--size", body.size]
    words += [w for codes in body.walls if _codes(codes) for w in ("--wall", codes)]
    words += [w for codes in body.heights if _codes(codes) for w in ("--same-height", codes)]
    html, plan, table = (f"reports/{stem}-survey.{kind}" for kind in ("html", "svg", "json"))
    words += ["-o", "map.yaml", "--report", html, "--plan", plan, "--json", "--force"]
    command = f"{shlex.join(['lmkit', *words])} > {shlex.quote(table)}"
    return Plan(f"Survey {body.source}", (_lmkit(words),), command, (html, plan, table), table, ("map.yaml",))


def plan_track(project: Project, body: JobBody) -> Plan:
    """The robot's trajectory from a recording."""
    found = _recording(project, body.source)
    stem = _stem(body.source)
    words = ["track", *_images(found), "--rig", _of(project, found, "rig"), "--map", _of(project, found, "map")]
    html, plan, tum = (f"reports/{stem}-track.{kind}" for kind in ("html", "svg", "tum"))
    words += [*_motion(found), *(["--live"] if body.live else []), "--tum", tum, "--plan", plan, "--report", html]
    words.append("--force")
    return _one_command(f"Track {body.source}", words, html, plan, tum)


def plan_calibrate(project: Project, body: JobBody) -> Plan:
    """The rig from a folder of pairs."""
    _board(body)
    if not any(pairs["name"] == body.source for pairs in listing(project)["pairs"]):
        raise InputError("no_pairs", f"{body.source[:80]!r} holds no folders left and right", "choose another folder")
    words, report = _calibration(body.source, body.board)
    return replace(_one_command(f"Calibrate from {body.source}", words, report), replaces=("rig.yaml",))


def plan_guide(project: Project, body: JobBody) -> Plan:
    """Guided calibration with cameras, films or a folder of pairs, until a stated depth error."""
    _board(body)
    if body.at_m not in DEPTHS:
        raise InputError("bad_value", f"at_m: {body.at_m:g} m is not shown", "choose 1, 2, 4 or 8 m")
    cameras = _board_cameras(project, body)
    folder = project.unused("pairs", _stem(body.source.replace(":", "-")), "")
    words, report = _calibration(folder, body.board)
    task = json.dumps(
        {
            "cameras": cameras, "board": body.board, "folder": folder, "at_m": body.at_m,
            "until_m": body.until_mm / 1000,
        }
    )  # fmt: skip
    shown = ["lmkit", "calibrate", *cameras, "--board", body.board, "--capture"]
    shown += [*(["--side-by-side"] if len(cameras) == 1 else []), "--save-pairs", folder, *words[words.index("-o") :]]
    steps = (("-m", "lmkit.web.guided", task), _lmkit(words))
    title = f"Calibrate with {' and '.join(s for s in (body.source, body.second) if s)}"
    return Plan(title, steps, shlex.join(shown), (report,), None, ("rig.yaml",), can_finish=True)


def _board_cameras(project: Project, body: JobBody) -> list[str]:
    """Sources of a guided calibration; a single source shows both cameras side by side.

    Raises:
        InputError: not sources of the project, or of different kinds.
    """
    given = [body.source, *([body.second] if body.second else [])]
    kinds = [_board_source(project, name) for name in given]
    if kinds == ["folder"]:
        return [f"{body.source}/left", f"{body.source}/right"]
    if len(set(kinds)) > 1 or "folder" in kinds or body.source == body.second:
        hint = "give two cameras, two films, or one source that shows both"
        raise InputError("unpaired", f"{body.source[:80]} and {body.second[:80]} do not go together", hint)
    return given


def _board_source(project: Project, name: str) -> str:
    """``camera``, ``film`` or ``folder``.

    Raises:
        InputError: none of them.
    """
    if CAMERA.fullmatch(name):
        return "camera"
    source = project.path(name)
    if source.is_file() and source.suffix.lower() in FILMS:
        return "film"
    if (source / "left").is_dir() and (source / "right").is_dir():
        return "folder"
    hint = "give camera:0, a film, or a folder with left and right, in the project"
    raise InputError("no_source", f"{name[:80]!r} is no camera, no film, and has no folders left and right", hint)


def plan_coverage(project: Project, body: JobBody) -> Plan:
    """The expected pose error at every place of the floor."""
    _require_map(project)
    drawing = "reports/coverage.svg"
    words = ["plan", "coverage", *_ground(project, body), "--map", "map.yaml", "-o", drawing, "--force"]
    return _one_command("Coverage of the floor", words, drawing)


def plan_place(project: Project, body: JobBody) -> Plan:
    """Sites for further landmarks, with a mounting list."""
    mounted = ["--map", "map.yaml"] if (project.root / "map.yaml").is_file() else []
    folder = "reports/mounting"
    words = ["plan", "place", *_ground(project, body), *mounted, "-o", folder, "--no-prints", "--force"]
    outputs = (f"{folder}/{name}" for name in ("mounting.pdf", "mounting.csv", "plan.png"))
    return _one_command("Sites of the next landmarks", words, *outputs)


def plan_sheet(project: Project, body: JobBody) -> Plan:
    """Mounting sheets of the map, as PDF."""
    _require_map(project)
    floor = _floor(project)
    words = ["plan", "sheet", "--map", "map.yaml", *(["--floor", floor] if floor else [])]
    words += ["-o", "reports/mounting-sheet.pdf", "--force"]
    return _one_command("Mounting sheet", words, "reports/mounting-sheet.pdf")


def plan_run(project: Project, body: JobBody) -> Plan:
    """A live run for the page: cameras, a recording, a recorded run, ``run.yaml``, or ``sim:``, a simulated robot."""
    if not can_run():
        raise InputError("no_run", "this lmkit has no command run", "track the recording instead")
    settings = _run_settings(project, body.source, body.second)
    if body.record:
        settings["record"] = project.unused("runs", "run", ".mcap")
    task = json.dumps(settings)
    words = ["run", *([settings.pop("file")] if "file" in settings else settings.pop("sources"))]
    words += [word for key, value in settings.items() for word in (f"--{key}", value)]
    names = " and ".join(name for name in (body.source, body.second) if name)
    title = "Simulated robot" if body.source == "sim:" else f"Run {names}"
    outputs = (settings["record"],) if body.record else ()
    step = ("-m", "lmkit.web.watched_run", task)
    return Plan(title, (step,), shlex.join(["lmkit", *words]), outputs, is_live=True)


def _run_settings(project: Project, source: str, second: str) -> dict[str, Any]:
    """Keys of a run file, or ``file``."""
    if CAMERA.fullmatch(source):
        return _camera_run(project, source, second)
    if source == "sim:":
        return {"sources": ["sim:"]}
    if source == "run.yaml":
        return {"file": "run.yaml"}
    if any(bag["name"] == source for bag in listing(project)["bags"]) and source.startswith("runs/"):
        return {"sources": [f"replay:{source}"]}
    found = _recording(project, source)
    if not found["images"]:
        raise InputError("no_images", f"{source} contains no images", "track its saved detections instead")
    settings: dict[str, Any] = {"sources": [f"{source}/left", f"{source}/right"]}
    settings |= {"rig": _of(project, found, "rig"), "map": _of(project, found, "map")}
    if found["odometry"]:
        settings["odometry"] = f"{source}/odometry.csv"
        settings |= {"gyro": f"{source}/gyro.csv"} if found["gyro"] else {}
    return settings


def _camera_run(project: Project, source: str, second: str) -> dict[str, Any]:
    """Keys of a run from cameras; a single camera shows left and right side by side if the rig has two.

    Raises:
        InputError: cameras that do not fit the rig, or no rig or map.
    """
    from lmkit.geometry.rig import mounted_cameras

    if second and (not CAMERA.fullmatch(second) or second == source):
        raise InputError("unpaired", f"{source} and {second[:80]!r} are no two cameras", "choose two different ones")
    nothing = {"own_rig": False, "own_map": False}
    settings = {key: _of(project, nothing, key) for key in ("rig", "map")}
    count = len(mounted_cameras(lm.read_rig(project.path("rig.yaml"))))
    if count > 2 or count < (2 if second else 1):
        problem = f"rig.yaml has {count} camera{'s' * (count > 1)}"
        raise InputError("unpaired", problem, "choose as many, or name all sources in run.yaml")
    if second:
        return {"sources": [source, second], **settings}
    return {"sources": [source if count == 1 else f"split:{source}"], **settings}


def can_run() -> bool:
    """Whether this lmkit has the command for live runs."""
    return importlib.util.find_spec("lmkit.cli.run") is not None


VERBS = {
    "example": plan_example,
    "unbag": plan_unbag,
    "survey": plan_survey,
    "track": plan_track,
    "calibrate": plan_calibrate,
    "guide": plan_guide,
    "coverage": plan_coverage,
    "place": plan_place,
    "sheet": plan_sheet,
    "run": plan_run,
}


def _one_command(title: str, words: list[str], *outputs: str) -> Plan:
    """The plan of a job that is one command of lmkit, and shows it."""
    return Plan(title, (_lmkit(words),), shlex.join(["lmkit", *words]), outputs)


def _lmkit(words: list[str]) -> tuple[str, ...]:
    return ("-m", "lmkit", *words)


def _calibration(source: str, board: str) -> tuple[list[str], str]:
    """Arguments of the command, and its report."""
    report = f"reports/{_stem(source)}-calibration.html"
    sides = [f"{source}/left", f"{source}/right"]
    return ["calibrate", *sides, "--board", board, "-o", "rig.yaml", "--report", report, "--force"], report


def _codes(text: str) -> bool:
    """Whether codes such as ``12,44`` are given.

    Raises:
        InputError: other text.
    """
    if text and not re.fullmatch(r"[0-9a-z:_]+(,[0-9a-z:_]+)+", text):
        raise InputError("bad_value", f"{text!r} is not a list of codes", "write two codes at least, such as 12,44")
    return bool(text)


def _board(body: JobBody) -> None:
    from lmkit.model.board import BoardSpec

    BoardSpec.parse(body.board)


def _recording(project: Project, name: str) -> dict[str, Any]:
    for found in listing(project)["recordings"]:
        if found["name"] == name:
            return dict(found)
    hint = "put a folder with left and right images, or detections.csv, into drives/"
    raise InputError("no_recording", f"there is no recording {name[:80]!r}", hint)


def _ground(project: Project, body: JobBody) -> list[str]:
    """Options of the floor, the rig and the requirement."""
    parse_length_mm(body.error, "error")
    floor, rigs = _floor(project), ["rig.yaml", *_in_recordings(project, "rig.yaml")]
    if floor is None:
        raise InputError(
            "no_floor",
            "the project has no floor.yaml",
            "draw the walls on the page Map, or take a floor plan there",
        )
    rig = next((name for name in rigs if project.path(name).is_file()), None)
    if rig is None:
        raise InputError("no_rig", "the project has no rig.yaml", "calibrate first")
    words = ["--floor", floor, "--rig", rig, "--error", body.error]
    if not body.camera_height:
        if lm.read_rig(project.path(rig)).T_base_left is None:
            problem = f"{rig} does not say how high the camera is mounted"
            raise InputError(
                "no_height",
                problem,
                "fill in the camera height, such as 85cm, or say on the page Calibrate where it is mounted",
            )
    else:
        parse_length_mm(body.camera_height, "camera_height")
        words += ["--camera-height", body.camera_height]
    return words


def _floor(project: Project) -> str | None:
    """The floor plan of the project, or of the first recording that has one."""
    names = ["floor.yaml", *_in_recordings(project, "floor.yaml")]
    return next((name for name in names if project.path(name).is_file()), None)


def _in_recordings(project: Project, name: str) -> list[str]:
    return [f"{found['name']}/{name}" for found in listing(project)["recordings"] if found["name"]]


def _require_map(project: Project) -> None:
    if not (project.root / "map.yaml").is_file():
        raise InputError("no_map", "the project has no map.yaml", "survey a recording first")


def _images(found: dict[str, Any]) -> list[str]:
    name = found["name"]
    prefix = f"{name}/" if name else ""
    if found["detections"]:
        return ["--detections", f"{prefix}{found['detections']}"]
    return [f"{prefix}left", f"{prefix}right"]


def _motion(found: dict[str, Any]) -> list[str]:
    if not found["odometry"]:
        return []
    words = ["--odometry", f"{found['name']}/odometry.csv"]
    return [*words, *(["--gyro", f"{found['name']}/gyro.csv"] if found["gyro"] else [])]


def _of(project: Project, found: dict[str, Any], what: str) -> str:
    """The project's rig or map, or else the recording's own."""
    if found[f"own_{what}"] and (what == "rig" or not (project.root / "map.yaml").is_file()):
        own = f"{found['name']}/{what}.yaml"
        return own if project.path(own).is_file() else f"{found['name']}/{what}"  # a folder, such as an unpacked bag
    if (project.root / f"{what}.yaml").is_file():
        return f"{what}.yaml"
    hint = "calibrate first" if what == "rig" else "survey a recording first, or write map.yaml"
    raise InputError(f"no_{what}", f"the project has no {what}.yaml", hint)


def _stem(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "-", Path(name).with_suffix("").as_posix()).strip("-")[:60] or "recording"
