"""Campaigns: closed-loop runs of one scenario with drawn plants, targets, noise and faults."""

from ffsms_pin.campaigns.definition import Campaign
from ffsms_pin.campaigns.report import by_method, report
from ffsms_pin.campaigns.runs import campaign, read_table

__all__ = ["Campaign", "by_method", "campaign", "read_table", "report"]
