"""The whole database: every table there is, in an order in which they can be made."""

from __future__ import annotations

from typing import Final

from sqlalchemy import MetaData, Table

from service.store.schema_access import SESSIONS, TOKENS, USERS
from service.store.schema_base import METADATA
from service.store.schema_health import BASELINES, FIGURES
from service.store.schema_models import MODELS
from service.store.schema_nightly import REMOVED_RECORDINGS, SCHEDULE_RUNS, VALVE_HEALTHS, VALVE_STATES
from service.store.schema_reanalyses import REANALYSES, REPEATS
from service.store.schema_tests import ANALYSES, TESTS
from service.store.schema_watched import WATCHED_DAYS

TABLES: Final[tuple[Table, ...]] = (
    TESTS,
    ANALYSES,
    VALVE_STATES,
    VALVE_HEALTHS,
    FIGURES,
    BASELINES,
    SCHEDULE_RUNS,
    REMOVED_RECORDINGS,
    MODELS,
    USERS,
    SESSIONS,
    TOKENS,
    REANALYSES,
    REPEATS,
    WATCHED_DAYS,
)
#: What describes all of them to Alembic.
WHOLE: Final[MetaData] = METADATA
