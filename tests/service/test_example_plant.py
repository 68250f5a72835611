"""The plant file that the README sends a new user to."""

from __future__ import annotations

from pathlib import Path

from drivers.maps import REGISTER_MAPS
from service.cli.simulated_plant import plant_from_settings
from service.config.settings import load_plant
from service.model.sequences import SEQUENCES

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "plant.toml"
DOCUMENT = EXAMPLE.parents[1] / "docs" / "plant.md"


def test_the_example_describes_a_plant_that_can_be_served_and_simulated() -> None:
    settings = load_plant(EXAMPLE)
    assert set(settings.valves) == {"FV-101", "FV-102"}
    assert set(plant_from_settings(settings).valves) == {"FV-101", "FV-102"}


def test_the_document_names_every_map_and_sequence() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert [name for name in (*REGISTER_MAPS, *SEQUENCES) if f"`{name}`" not in text] == []
