"""Campaigns: one scenario, run many times with plants, targets, noise and faults that are drawn.

`campaign` runs them into a folder, `merge` makes one Parquet file and a report of it, `drawn_scenario` gives
any single run back by its seed. docs/campaigns.md explains the folder and the table.
"""

from typing import TYPE_CHECKING

from ffsms_pin.campaigns.report import (
    Report as Report,
    merge as merge,
    report as report,
    runs_file as runs_file,
)
from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.campaigns.definition import Campaign as Campaign
    from ffsms_pin.campaigns.single import campaign as campaign, replayed_scenario as replayed_scenario
    from ffsms_pin.studies.numbers import wilson_interval as wilson_interval
else:
    __getattr__, __dir__, __all__ = later(__name__)
