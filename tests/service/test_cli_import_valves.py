"""``breakaway import-valves``: many valves at once, all faults by row and column, and nothing or all written."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from service.config.settings import load_plant
from service.config.valve_import import import_valves
from tests.service.command_line import called
from tests.support.plants import PRESSURE_PA
from valve.errors import ConfigurationError

HEADER = "Tag,Description,Area,Travel (in),diaphragm area,bench_set,safe_value,bus,device_id,serial_number\n"
ROWS = (
    'FV-201,"Feed, left",Unit 2,4,100 in2,3 to 15 psi,0 psi,plc-1,11,00123\n'
    "FV-202,,Unit 2,2.5,50 in2,3-15 psi,entry,plc-1,12,\n"
)


def write(folder: Path, text: str, encoding: str = "utf-8") -> str:
    path = folder / "valves.csv"
    path.write_bytes(text.encode(encoding))
    return str(path)


def test_valves_of_a_table_come_behind_those_that_are_there(plant_file: Path, plant_text: str) -> None:
    plant_file.chmod(0o640)
    table = write(plant_file.parent, HEADER + ROWS + ",,,,,,,,,\n")
    answer = called("import-valves", table, "--config", str(plant_file), "--like", "FV-101")
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "2 valves added. Next: `breakaway reload`" in answer.stdout
    assert plant_file.read_text(encoding="utf-8").startswith(plant_text.rstrip())
    assert plant_file.stat().st_mode & 0o777 == 0o640
    assert called("check", "--config", str(plant_file)).returncode == 0
    plant = load_plant(plant_file)
    assert list(plant.valves) == ["FV-101", "FV-102", "FV-201", "FV-202"]
    first, second = plant.valves["FV-201"], plant.valves["FV-202"]
    assert (first.identity.description, first.identity.area) == ("Feed, left", "Unit 2")
    assert (first.identity.serial_number, second.identity.serial_number) == ("00123", None)
    assert (first.nameplate.actuator.travel_m, second.nameplate.actuator.travel_m) == (0.1016, 0.0635)
    assert first.nameplate.actuator.diaphragm_area_m2 == 0.064516
    assert first.nameplate.actuator.bench_set_pa == (20684.2718795, 103421.359398)
    assert (first.wiring.safe_value_pa, second.wiring.safe_value_pa) == (0.0, "entry")
    assert [one.wiring.command.device_id for one in (first, second)] == [11, 12]
    assert first.wiring.limits == plant.valves["FV-101"].wiring.limits  # what the rows leave open
    assert first.wiring.limits.pressure_pa == PRESSURE_PA


def test_a_column_gives_each_valve_its_class_of_limits(plant_file: Path, plant_text: str) -> None:
    plant_file.write_text(f"[classes.isolation]\nstroke_time_max_s = 20.0\n{plant_text}", encoding="utf-8")
    table = write(plant_file.parent, HEADER.replace("serial_number", "Class") + ROWS.replace("00123", "isolation"))
    answer = called("import-valves", table, "--config", str(plant_file), "--like", "FV-101")
    assert (answer.returncode, answer.stderr) == (0, "")
    plant = load_plant(plant_file)
    assert [plant.valves[tag].health.stroke_time_max_s for tag in ("FV-201", "FV-202")] == [20.0, None]
    unknown = import_valves(
        f"{HEADER.replace('serial_number', 'class')}{ROWS.replace('00123', 'isolatoin')}".replace(
            "FV-2", "FV-4"
        ).encode(),
        "valves.csv",
        plant_file,
        "FV-101",
    )
    assert any("column class" in one.key and "write isolation" in one.remedy for one in unknown.faults)


def test_five_hundred_valves_are_imported_at_once(plant_file: Path) -> None:
    plc = '[[buses]]\nname = "plc-{0}"\nkind = "modbus_tcp"\nhost = "10.0.0.{0}"\nport = 502\n'
    text = plant_file.read_text(encoding="utf-8")
    plant_file.write_text(text + "".join(plc.format(number) for number in range(2, 12)), encoding="utf-8")
    rows = "".join(
        f"FV-{1000 + one},,,4,100 in2,3 to 15 psi,0 psi,plc-{2 + one // 50},{1 + one % 50},\n" for one in range(500)
    )
    table = write(plant_file.parent, HEADER + rows)
    began_s = time.monotonic()
    answer = called("import-valves", table, "--config", str(plant_file), "--like", "FV-101")
    assert (answer.returncode, answer.stderr) == (0, "")
    assert time.monotonic() - began_s < 60.0
    assert len(load_plant(plant_file).valves) == 502


def test_all_faults_are_told_by_row_and_column_and_nothing_is_written(plant_file: Path) -> None:
    before = plant_file.read_bytes()
    rows = (
        "FV-201,,,4 kg,100 in2,3 to 15 psi,0 psi,plc-1,11,\n"
        "FV-201,,,4,100 in,15 to 3 psi,open,plc-1,x,\n"
        "FV-101,,,4,100,3 psi,,plc-9,1,\n"
    )
    answer = called(
        "import-valves", write(plant_file.parent, HEADER + rows), "--config", str(plant_file), "--like", "FV-101"
    )
    assert answer.returncode == 1
    assert "no valve was imported" in answer.stderr
    assert plant_file.read_bytes() == before
    lines = answer.stdout.splitlines()
    for number, column, says in (
        (2, "Travel (in)", ['"4 kg"', "kg is no length", "in, mm, cm or m"]),
        (3, "Tag", ['"FV-201"', "another valve has this tag", "rename one"]),
        (3, "diaphragm area", ['"100 in"', "in is no area"]),
        (3, "bench_set", ['"15 to 3 psi"', "it must rise", "give the lower value first"]),
        (3, "safe_value", ['"open"', 'or "entry"']),
        (3, "device_id", ['"x"', "integer"]),
        (4, "Tag", ['"FV-101"', "another valve has this tag"]),
        (4, "diaphragm area", ['"100"', "its unit is unknown"]),
        (4, "bench_set", ['"3 psi"', "give both ends such as 3 to 15 psi"]),
        (4, "bus", ['"plc-9"', "choose one of plc-1"]),
        (4, "safe_value", ["it is missing", "add it"]),
    ):
        start = f"valves.csv: row {number}, column {column}"
        assert any(line.startswith(start) and all(part in line for part in says) for line in lines), (start, lines)
    assert not any("valves[" in line or "quotes" in line for line in lines if "device_id" not in line)
    numbers = [int(line.split()[2].rstrip(",")) for line in lines]
    assert numbers == sorted(numbers)


def test_a_cell_that_only_physics_refuses_is_told_by_its_column(plant_file: Path) -> None:
    rows = "FV-201,,,4000,100 in2,3 to 15 psi,0 psi,plc-1,11,\nFV-202,,,4,100 in2,3 to 15 psi,90 psi,plc-1,12,\n"
    path = write(plant_file.parent, HEADER + rows)
    answer = called("import-valves", path, "--config", str(plant_file), "--like", "FV-101")
    lines = answer.stdout.splitlines()
    assert any(line.startswith('valves.csv: row 2, column Travel (in) = "4000": ') for line in lines), lines
    assert any(line.startswith('valves.csv: row 3, column safe_value = "90 psi": ') for line in lines), lines


def test_what_no_column_gives_is_told_once_for_all_rows(plant_file: Path) -> None:
    answer = called("import-valves", write(plant_file.parent, HEADER + ROWS), "--config", str(plant_file))
    lines = answer.stdout.splitlines()
    assert "valves.csv: all 2 rows, limits: it is missing: add it" in lines
    assert "valves.csv: all 2 rows, acquisition: it is missing: add it" in lines
    assert len([line for line in lines if "device_id and map belong together" in line]) == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tag,travl\nA,4 in\n", 'row 1, column 2 = "travl": no key has this name: call it travel'),
        ("tag,travel,actuator.travel\nA,4 in,4 in\n", "column travel gives actuator.travel already: remove one"),
        ("travel\n4 in\n", "row 1: no column is called tag"),
        ("", "row 1: no column is called tag"),
        ("tag,travel\n\n,\n", "row 2: no valve follows"),
        ("tag,travel\nA,4 in,17\n", 'row 2, column 3 = "17": the first row names 2 columns'),
    ],
)
def test_a_table_of_a_wrong_shape_is_refused_with_its_place(plant_file: Path, text: str, says: str) -> None:
    found = import_valves(text.encode(), "valves.csv", plant_file, "FV-101")
    assert not found.tags
    assert any(says in str(fault) for fault in found.faults), found.faults


def test_a_table_of_a_german_spreadsheet_is_read(plant_file: Path) -> None:
    text = HEADER.replace(",", ";") + "FV-201;Zulauf Kühler;;2,5;645,16 cm2;0,2 bis 1 bar;0 bar;plc-1;11;\n"
    text = text.replace("bis", "to")
    found = import_valves(text.encode("cp1252"), "valves.csv", plant_file, "FV-101")
    assert not found.faults
    plant_file.write_text(found.text, encoding="utf-8")
    valve = load_plant(plant_file).valves["FV-201"]
    assert valve.identity.description == "Zulauf Kühler"
    assert valve.nameplate.actuator.travel_m == 0.0635
    assert valve.nameplate.actuator.bench_set_pa == (20.0e3, 100.0e3)


def test_a_column_may_be_a_key_in_si_and_stands_before_the_valve_alike(plant_file: Path) -> None:
    text = "tag,safe_value_pa,travel_m,limits.pressure_pa,steps_allowed,device_id\nA,0,0.05,0 to 50000,yes,11\n"
    found = import_valves(text.encode(), "valves.csv", plant_file, "FV-101")
    assert not found.faults
    plant_file.write_text(found.text, encoding="utf-8")
    valve = load_plant(plant_file).valves["A"]
    assert valve.nameplate.actuator.travel_m == 0.05
    assert (valve.wiring.limits.pressure_pa, valve.wiring.limits.steps_allowed) == ((0.0, 50.0e3), True)


def test_a_dry_run_writes_nothing(plant_file: Path) -> None:
    before = plant_file.read_bytes()
    table = write(plant_file.parent, HEADER + ROWS)
    answer = called("import-valves", table, "--config", str(plant_file), "--like", "FV-101", "--dry-run")
    assert (answer.returncode, plant_file.read_bytes()) == (0, before)
    assert "no fault: 2 valves, nothing was written" in answer.stdout


def test_the_safe_value_is_never_taken_from_another_valve(plant_file: Path) -> None:
    found = import_valves(b"tag,device_id\nA,11\n", "valves.csv", plant_file, "FV-101")
    assert [str(fault) for fault in found.faults] == ["valves.csv: row 2, safe_value_pa: it is missing: add it"]


def test_no_valve_is_driven_or_read_at_the_place_of_another(plant_file: Path, plant_text: str) -> None:
    found = import_valves(b"tag,safe_value\nA,entry\n", "valves.csv", plant_file, "FV-101")
    assert [str(fault) for fault in found.faults] == [
        "valves.csv: row 2, command: bus plc-1: device_id and map belong together, give both or (gauge) none"
    ]
    found = import_valves(b"tag,safe_value,device_id\nA,entry,11\n", "valves.csv", plant_file, "FV-102")  # on a gauge
    assert [str(fault) for fault in found.faults] == ["valves.csv: row 2, position.bus: it is missing: add it"]
    contact = (
        '[valves.permissives.manual]\nbus = "plc-1"\ndevice_id = 9\nmap = "reference"\nregister = "status"\nbit = 2\n'
    )
    plant_file.write_text(plant_text + contact, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"FV-102 has permissives.manual, which shows that valve alone"):
        import_valves(b"tag,safe_value,device_id\nA,entry,11\n", "valves.csv", plant_file, "FV-102")


def test_what_is_not_there_is_said(plant_file: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no valve has the tag FV-999"):
        import_valves(b"tag\nA\n", "valves.csv", plant_file, "FV-999")
    with pytest.raises(ConfigurationError, match="breakaway init"):
        import_valves(b"tag\nA\n", "valves.csv", tmp_path / "none.toml")
    answer = called("import-valves", str(tmp_path / "none.csv"), "--config", str(plant_file))
    assert (answer.returncode, "none.csv: it cannot be read" in answer.stderr) == (1, True)
