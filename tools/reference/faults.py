"""Generate the blocks about faults from the declarations in ``handctl.safety.faults``."""

from handctl.safety.faults.markdown import (
    catalogue_markdown,
    fault_sections,
    fault_table_markdown,
    hardware_checklist,
    late_reactions_markdown,
)

__all__ = [
    "catalogue_markdown",
    "fault_sections",
    "fault_table_markdown",
    "hardware_checklist",
    "late_reactions_markdown",
]
