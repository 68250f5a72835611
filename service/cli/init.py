"""``breakaway init``: a plant file of one valve, from questions or from options alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from drivers.addresses import MotionLimits
from drivers.capabilities import Role
from drivers.maps import REGISTER_MAPS
from service.config.units import as_value, in_si
from service.config.valves import ValveSection
from valve.errors import ConfigurationError
from valve.messages import joined, say
from valve.nameplate import Actuator

_SIGNAL_A: Final = [0.004, 0.020]
_HEAD: Final = """\
# Written by `breakaway init`. Every key is explained in docs/plant.md.
# `breakaway check --config FILE --live` looks at the device and writes nothing.

"""
_NEEDED: Final = object()  # the default of a question that has none
_Answers = dict[str, str]


@dataclass(frozen=True, slots=True)
class _Question:
    """One question: its option, its words, what is taken without an answer, and who judges an answer.

    ``fault`` returns why an answer cannot be, "" where it can; ``when`` says whether the others make it a question.
    """

    option: str
    words: str
    default: Any = _NEEDED
    fault: Callable[[str], str] = lambda _: ""
    when: Callable[[_Answers], bool] = lambda _: True


def _with_unit(kind: Any, key: str) -> Callable[[str], str]:
    """Return who judges a value with a unit of this key."""

    def fault(answer: str) -> str:
        found = in_si(kind, {key: as_value(answer)}).faults
        return f"{found[0].reason}: {found[0].remedy.replace(', in quotes', '')}" if found else ""

    return fault


def _range_with_unit(kind: Any, key: str) -> Callable[[str], str]:
    def fault(answer: str) -> str:
        if not isinstance(as_value(answer), list):
            return "it is no range: give both ends and their unit, such as 3 to 15 psi"
        return _with_unit(kind, key)(answer)

    return fault


def _one_of(*words: str) -> Callable[[str], str]:
    return lambda answer: "" if answer in words else say("choose_one_of", "choose one of {known:, }", known=words)


def _whole(answer: str) -> str:
    return "" if answer.isdecimal() else say("answer_no_whole_number", "give a whole number")


def _is_module(answers: _Answers) -> bool:
    """Whether the device is a module with 4 to 20 mA at its terminals, which counts in no pressure and no travel."""
    return REGISTER_MAPS[answers["map"]].register(REGISTER_MAPS[answers["map"]].roles[Role.COMMAND]).unit == "A"


def _has_watchdog(answers: _Answers) -> bool:
    return bool(REGISTER_MAPS[answers["map"]].watchdog)


def _usual_rate(answers: _Answers) -> str:
    """Return half of the signal's span a second, in the unit that it was given in."""
    low, high = (str(end).partition(" ") for end in as_value(answers["signal_range"]))
    return f"{(float(high[0]) - float(low[0])) / 2.0:g} {high[2]}/s"


_MAPS: Final = tuple(
    name
    for name, device in REGISTER_MAPS.items()
    if {Role.COMMAND, Role.POSITION} <= device.roles.keys()
    and device.register(device.roles[Role.COMMAND]).unit in ("Pa", "A")
)
_QUESTIONS: Final = (
    _Question("tag", "Tag of the valve, such as FV-101"),
    _Question("description", "What it does, in a line (may stay empty)", ""),
    _Question("area", "Area of the plant (may stay empty)", ""),
    _Question("class_", "Class of its acceptance limits, such as isolation (may stay empty)", ""),
    _Question("map", f"Device that drives its I/P ({', '.join(_MAPS)})", "reference", _one_of(*_MAPS)),
    _Question("bus", "How the device is reached (tcp, rtu)", "tcp", _one_of("tcp", "rtu")),
    _Question("host", "Its address or name on the network", when=lambda answers: answers["bus"] == "tcp"),
    _Question("port", "Its port", "502", _whole, lambda answers: answers["bus"] == "tcp"),
    _Question("serial_port", "Serial port, such as /dev/ttyUSB0", when=lambda answers: answers["bus"] == "rtu"),
    _Question("baud_rate", "Baud rate", "19200", _whole, lambda answers: answers["bus"] == "rtu"),
    _Question("parity", "Parity (N, E, O)", "E", _one_of("N", "E", "O"), lambda answers: answers["bus"] == "rtu"),
    _Question("device_id", "Modbus device id", "1", _whole),
    _Question("travel", "Rated travel with its unit, such as 4 in", fault=_with_unit(Actuator, "travel")),
    _Question(
        "diaphragm_area",
        "Diaphragm area with its unit, such as 100 in2",
        fault=_with_unit(Actuator, "diaphragm_area"),
    ),
    _Question("action", "Actuator (spring, double)", "spring", _one_of("spring", "double")),
    _Question(
        "bench_set",
        "Bench set, such as 3 to 15 psi (may stay empty)",
        "",
        lambda answer: _range_with_unit(Actuator, "bench_set")(answer) if answer else "",
        lambda answers: answers["action"] == "spring",
    ),
    _Question(
        "signal_range",
        "Pressure that the I/P gives at 4 to 20 mA, such as 3 to 15 psi",
        fault=_range_with_unit(MotionLimits, "pressure"),
    ),
    _Question(
        "safe_value",
        'Safe value: the pressure that it is sent to however a test ends, such as 3 psi, or "entry": the one before it',
        fault=_with_unit(ValveSection, "safe_value"),
    ),
    _Question(
        "pressure_rate",
        "How fast the pressure may change in a test",
        _usual_rate,
        _with_unit(MotionLimits, "pressure_rate"),
    ),
    _Question("longest_test", "How long a test may take", "5 min", _with_unit(MotionLimits, "longest_test")),
    _Question(
        "watchdog_waived",
        "This device has no watchdog: what makes the valve safe if the service dies in a test",
        when=lambda answers: not _has_watchdog(answers),
    ),
    _Question(
        "manual_waived",
        "This device does not show whether the loop is in manual: why that needs no proof (empty: each test asks for a "
        "work permit)",
        "",
        when=_is_module,
    ),
)


def init(
    *,
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file to write.")] = Path(
        "plant.toml"
    ),
    tag: Annotated[str | None, typer.Option(metavar="TAG", help="Tag of the valve.")] = None,
    description: Annotated[str | None, typer.Option(metavar="TEXT", help="What it does.")] = None,
    area: Annotated[str | None, typer.Option(metavar="TEXT", help="Area of the plant.")] = None,
    class_: Annotated[
        str | None, typer.Option("--class", metavar="NAME", help="Class that its acceptance limits come from.")
    ] = None,
    map: Annotated[str | None, typer.Option("--map", metavar="MAP", help=f"Device: {', '.join(_MAPS)}.")] = None,  # noqa: A002
    bus: Annotated[str | None, typer.Option(metavar="KIND", help="How it is reached: tcp or rtu.")] = None,
    host: Annotated[str | None, typer.Option(metavar="HOST", help="Address of the device (tcp).")] = None,
    port: Annotated[str | None, typer.Option(metavar="NUMBER", help="Port of the device (tcp), 502.")] = None,
    serial_port: Annotated[str | None, typer.Option(metavar="PATH", help="Serial port (rtu).")] = None,
    baud_rate: Annotated[str | None, typer.Option(metavar="NUMBER", help="Baud rate (rtu), 19200.")] = None,
    parity: Annotated[str | None, typer.Option(metavar="LETTER", help="Parity (rtu): N, E or O.")] = None,
    device_id: Annotated[str | None, typer.Option(metavar="NUMBER", help="Modbus device id, 1.")] = None,
    travel: Annotated[str | None, typer.Option(metavar="LENGTH", help='Rated travel, "4 in".')] = None,
    diaphragm_area: Annotated[str | None, typer.Option(metavar="AREA", help='Diaphragm area, "100 in2".')] = None,
    action: Annotated[str | None, typer.Option(metavar="WORD", help="spring or double.")] = None,
    bench_set: Annotated[str | None, typer.Option(metavar="RANGE", help='Bench set, "3 to 15 psi".')] = None,
    signal_range: Annotated[
        str | None, typer.Option(metavar="RANGE", help='Pressure at 4 to 20 mA, "3 to 15 psi".')
    ] = None,
    safe_value: Annotated[
        str | None, typer.Option(metavar="PRESSURE", help='Where a test leaves the valve: "3 psi", or entry.')
    ] = None,
    pressure_rate: Annotated[
        str | None, typer.Option(metavar="RATE", help='Fastest change of pressure in a test, "5 psi/s".')
    ] = None,
    longest_test: Annotated[str | None, typer.Option(metavar="TIME", help='Longest test, "5 min".')] = None,
    watchdog_waived: Annotated[
        str | None, typer.Option(metavar="REASON", help="Why a device without a watchdog is safe.")
    ] = None,
    manual_waived: Annotated[
        str | None, typer.Option(metavar="REASON", help="Why the manual mode needs no proof; else a permit does.")
    ] = None,
) -> None:
    """Write a plant file of one valve. What no option says is asked; where nothing needed is missing, nothing is asked.

    A file that is there is never changed. More valves: `breakaway import-valves`, or docs/plant.md.
    """
    from service.config.settings import faults_of

    given = {
        name: value.strip()
        for name, value in locals().items()
        if isinstance(value, str) and any(name == one.option for one in _QUESTIONS)
    }
    if config.exists():
        raise ConfigurationError(
            say(
                "config_exists",
                "{config}: it is there already and stays as it is: give another --config",
                config=str(config),
            )
        )
    text = _HEAD.replace("FILE", str(config)) + _text(_answers(given))
    _, faults = faults_of(config, text)
    if faults:
        not_written = say("not_written", "{config} was not written: answer otherwise", config=str(config))
        raise ConfigurationError(joined("\n", [*(fault.message for fault in faults), not_written]))
    try:
        with config.open("x", encoding="utf-8") as file:  # "x": also one that came meanwhile stays as it is
            file.write(text)
    except OSError as error:
        raise ConfigurationError(
            say(
                "config_unwritable",
                "{config}: it cannot be written ({reason}): give another --config",
                config=str(config),
                reason=str(error.strerror),
            )
        ) from None
    print(
        say(
            "config_written",
            "{config}: written, no fault. Next: breakaway check --config {config} --live",
            config=str(config),
        )
    )


def _answers(given: Mapping[str, str]) -> _Answers:
    """Return an answer to every question that arises. Raises ConfigurationError for one that cannot be."""
    for question in _QUESTIONS:
        fault = question.fault(given[question.option]) if question.option in given else ""
        if fault:
            raise ConfigurationError(
                say(
                    "answer_refused",
                    "{question} = {answer}: {fault}",
                    question=_named(question),
                    answer=given[question.option],
                    fault=fault,
                )
            )
    asks, answers = _is_asked(given), _Answers()
    for question in _QUESTIONS:
        if not question.when(answers):
            if question.option in given:
                raise ConfigurationError(
                    say(
                        "answer_without_meaning",
                        "{question}: with the other answers it has no meaning: leave it out",
                        question=_named(question),
                    )
                )
            continue
        default = question.default(answers) if callable(question.default) else question.default
        if question.option in given:
            answers[question.option] = given[question.option]
        elif asks:
            answers[question.option] = _asked(question, default)
        else:
            answers[question.option] = default
    return answers


def _named(question: _Question) -> str:
    return f"--{question.option.rstrip('_').replace('_', '-')}"


def _is_asked(given: Mapping[str, str]) -> bool:
    """Whether an answer is missing that has no default, where every other default is taken."""
    answers = _Answers()
    for question in _QUESTIONS:
        if question.when(answers):
            if question.option not in given and question.default is _NEEDED:
                return True
            usual = question.default if isinstance(question.default, str) else ""
            answers[question.option] = given.get(question.option, usual)
    return False


def _asked(question: _Question, default: Any) -> str:
    """Ask until the answer can be."""
    while True:
        try:
            shown = None if default is _NEEDED else default
            answer = str(typer.prompt(question.words, default=shown, show_default=bool(shown))).strip()
        except typer.Abort:
            raise ConfigurationError(
                say("answer_missing", "no answer for {question}: nothing was written", question=_named(question))
            ) from None
        fault = question.fault(answer)
        if not fault:
            return answer
        typer.echo(f"  {answer}: {fault}", err=True)


def _text(answers: _Answers) -> str:
    """Return the plant file of these answers."""
    import tomlkit

    number, module = int(answers["device_id"]), _is_module(answers)
    if answers["bus"] == "tcp":
        bus: dict[str, Any] = {"name": "bus-1", "kind": "modbus_tcp", "host": answers["host"]}
        bus["port"] = int(answers["port"])
    else:
        bus = {"name": "bus-1", "kind": "modbus_rtu", "serial_port": answers["serial_port"]}
        bus |= {"baud_rate": int(answers["baud_rate"]), "parity": answers["parity"]}
    pressure = as_value(answers["signal_range"])
    place: dict[str, Any] = {"bus": "bus-1", "device_id": number, "map": answers["map"]}
    valve: dict[str, Any] = {"tag": answers["tag"]}
    valve |= {name.rstrip("_"): answers[name] for name in ("description", "area", "class_") if answers[name]}
    valve["safe_value"] = answers["safe_value"]
    valve["actuator"] = {name: answers[name] for name in ("diaphragm_area", "travel", "action")}
    if answers.get("bench_set"):
        valve["actuator"]["bench_set"] = as_value(answers["bench_set"])
    valve["signal"] = {"range_ma": [4.0, 20.0], "range": pressure}
    valve["limits"] = {"pressure": pressure} | {name: answers[name] for name in ("pressure_rate", "longest_test")}
    valve["command"] = place | ({"signal": _SIGNAL_A, "quantity": pressure} if module else {})
    if module:
        valve["position"] = place | {"signal": _SIGNAL_A, "quantity": ["0 mm", answers["travel"]]}
    samples = "captured" if REGISTER_MAPS[answers["map"]].capture is not None else "polled"
    valve["acquisition"] = {"mode": samples, "period": "1 ms" if samples == "captured" else "50 ms"}
    valve["watchdog"] = {"timeout": "2 s"} if _has_watchdog(answers) else {"waived": answers["watchdog_waived"]}
    if module:
        waived = answers["manual_waived"]
        valve["permissives"] = {"manual_waived": waived} if waived else {"permit": True}
    plant: dict[str, Any] = {"service": {"store": "store"}, "buses": [bus]}
    if answers["class_"]:
        limits = tomlkit.table()
        limits.comment("limits of all valves of this class: docs/health.md")
        plant["classes"] = {answers["class_"]: limits}
    return tomlkit.dumps(plant | {"valves": [valve]})
