"""Flight-test logs on a uniform sampling grid: read, clean, smooth, cut into pushes and pulls.

Steps whose module bears their own name come from there: `from data_prep.prepare import prepare`.
"""

from data_prep.config import LogsConfig
from data_prep.events import Event, EventsConfig, find_events
from data_prep.log import Audit, AuditEntry, Log, Source
from data_prep.prepare import Prepared
from data_prep.ranking import pearson
from data_prep.reading import read_logs

__all__ = [
    "Audit",
    "AuditEntry",
    "Event",
    "EventsConfig",
    "Log",
    "LogsConfig",
    "Prepared",
    "Source",
    "find_events",
    "pearson",
    "read_logs",
]
