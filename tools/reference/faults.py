"""Blocks about faults, generated from the declarations in ``handctl.safety.faults``."""

from handctl.safety.faults.markdown import catalogue, checklist, fault_sections, fault_table, later

__all__ = ["catalogue", "checklist", "fault_sections", "fault_table", "later"]
