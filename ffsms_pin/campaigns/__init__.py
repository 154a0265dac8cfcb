"""Campaigns: one scenario, run many times with plants, targets, noise and faults that are drawn.

`campaign` runs them into a folder, `merge` makes one Parquet file and a report of it, `drawn_scenario` gives
any single run back by its seed. docs/campaigns.md explains the folder and the table.
"""

from ffsms_pin.campaigns.definition import Campaign
from ffsms_pin.campaigns.report import Report, merge, report, runs_file
from ffsms_pin.campaigns.single import campaign, replayed_scenario
from ffsms_pin.studies.numbers import wilson_interval

__all__ = [
    "Campaign",
    "Report",
    "campaign",
    "merge",
    "replayed_scenario",
    "report",
    "runs_file",
    "wilson_interval",
]
