"""What the answers of /api/v1 are made of: every field, type and unit.

Answers are plain data; tests/web/test_web_schema.py checks real ones against these types.
"""

from pydantic import ConfigDict

from league.matchmaking.divisions import SeasonSettings
from league.matchmaking.ratings.table import Difference
from league.matchmaking.safety import Safety
from league.matchmaking.scores import BestLap, HistoryPoint
from league.matchmaking.seasons import Trophy
from league.matchmaking.standings import HeadToHead, Row
from league.matchmaking.store import Cup, LeagueEntry, Season
from league.web.charts import ComparedLaps, SpeedMap
from league.web.pages.driver import Ancestor
from league.web.pages.heats import LapFaults
from league.web.pages.table import Marks

for _known in (
    *(Ancestor, BestLap, ComparedLaps, Cup, Difference, HeadToHead, HistoryPoint, LapFaults),
    *(LeagueEntry, Marks, Row, Safety, Season, SeasonSettings, SpeedMap, Trophy),
):
    # The texts below their fields become descriptions, as those of the answers do.
    setattr(_known, "__pydantic_config__", ConfigDict(use_attribute_docstrings=True))  # noqa: B010
