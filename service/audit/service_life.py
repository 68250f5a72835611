"""The service's own start and end in the audit log, and the log's head in the service's log."""

from __future__ import annotations

import hashlib

import structlog

from drivers.motion.audit_log import AuditError, AuditLog
from service.config.plant import Plant

_LOG = structlog.get_logger(__name__)


def note_start(audit: AuditLog, plant: Plant, software: str) -> None:
    """Write down which software serves which configuration. Raises AuditError."""
    try:
        configuration = hashlib.sha256(plant.file.read_bytes()).hexdigest()
    except OSError:  # it was read a moment ago, and may be gone since
        configuration = ""
    access = plant.service.access
    details = {
        "software": software,
        "configuration_sha256": configuration,
        "bind": plant.service.bind,
        "sign_in": access.sign_in,
        "tls": access.tls_certificate is not None,
    }
    audit.append("service.started", who="service", details=details)
    _note_head(audit)


def note_end(audit: AuditLog) -> None:
    """Write down that the service ended in order; a log that cannot be written any more is said in the other one."""
    try:
        audit.append("service.ended", who="service")
        _note_head(audit)
    except AuditError as error:
        _LOG.error("the end is not in the audit log", error=str(error))


def _note_head(audit: AuditLog) -> None:
    # Elsewhere than in the audit log: whoever cuts its end off would have to reach this log too.
    count, head = audit.head
    _LOG.info("audit log", file=audit.path.name, entries=count, head=head)
