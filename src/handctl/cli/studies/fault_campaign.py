"""``handctl fault campaign``: simulate every fault of the fault matrix on a hand in lockstep."""

import argparse
import json
import re
from collections.abc import Callable
from pathlib import Path

from handctl.campaign.campaign import CampaignReport
from handctl.campaign.campaign import run_campaign as run_campaign
from handctl.campaign.campaign_page import summary_lines, write_page
from handctl.campaign.fault_matrix import ALL_PROTOCOLS, FAULT_MATRIX, scenarios_of_hand
from handctl.campaign.run_stages import hand_with_protocol
from handctl.campaign.scenario_run import ScenarioResult
from handctl.cli.console.options import check_seed, print_json
from handctl.cli.console.progress import progress_bar
from handctl.errors import ConfigError
from handctl.log.tick_packing import pack_tick_record
from handctl.log.write.recorder import Recorder
from handctl.output_files import write_text_atomically
from handctl.session.exit_codes import ExitCode
from handctl.session.lockstep_simulation import SimulatedRun
from handctl.session.run_header import run_header
from handctl.session.run_plan import RunPlan, default_control_rate

QUICK_FAULT_FREE_S = 4.0
"""Simulated time without faults for each drive protocol, in a campaign with ``--quick`` [s]."""
FAULT_FREE_S = 60.0
"""Simulated time without faults for each drive protocol, in a campaign without ``--quick`` [s]."""
MAX_JOBS = 64
FIRST_PROGRESS_LABEL = "bringing the hand to its stages"
MAX_FAULT_FREE_S = 86_400.0


def run(args: argparse.Namespace) -> int:
    """Run a fault campaign, write the reports, and return the exit code.

    The command fails if a scenario fails, or if an alarm occurs in a run without injected faults.
    """
    check_seed(args.seed)
    if not 1 <= args.jobs <= MAX_JOBS:
        raise ConfigError(f"{args.jobs}", "--jobs", f"1 to {MAX_JOBS}")
    for id_ in set(args.row) - {row.id for row in FAULT_MATRIX}:
        raise ConfigError(
            repr(id_), "--row", "one of " + ", ".join(dict.fromkeys(row.id for row in FAULT_MATRIX))
        )
    if args.calm is not None and not 0 <= args.calm <= MAX_FAULT_FREE_S:
        raise ConfigError(f"{args.calm:g}", "--calm", f"0 to {MAX_FAULT_FREE_S:g} s")
    protocols = ALL_PROTOCOLS if args.protocol == "all" else (args.protocol,)
    campaign_fields = {
        scenario.row.id
        for name in protocols
        for scenario in scenarios_of_hand(hand_with_protocol(args.hand, name), name, 1.0)
    }
    for id_ in sorted(set(args.row) - campaign_fields):
        raise ConfigError(
            repr(id_), "--row", f"a fault that can occur in this hand with {args.protocol} drives"
        )
    folder = report_folder(args)
    fault_free_s = (
        args.calm if args.calm is not None else QUICK_FAULT_FREE_S if args.quick else FAULT_FREE_S
    )
    with progress_bar(FIRST_PROGRESS_LABEL, quiet=args.json) as update_progress:
        report = run_campaign(
            args.hand,
            protocols,
            default_control_rate,
            jobs=args.jobs,
            is_quick=args.quick,
            fault_free_s=fault_free_s,
            on_progress=lambda protocol, done, total: update_progress(done, total, protocol),
            on_failure=failure_log_writer(folder),
            row_ids=args.row,
            fault_free_only=args.calm_only,
            seed=args.seed,
        )
    write_page(folder / "report.html", report)
    write_text_atomically(folder / "report.json", json.dumps(report.as_json(), indent=1))
    _print_report(report, folder, args.json)
    figures = report.as_json()
    return ExitCode.FAILED if figures["late"] or figures["false_alarms"] else ExitCode.DONE


def report_folder(args: argparse.Namespace) -> Path:
    """Create and return the folder for the reports and for the logs of failed scenarios."""
    folder: Path = args.output or Path("logs") / "campaign"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _print_report(report: CampaignReport, folder: Path, as_json: bool) -> None:
    if as_json:
        print_json(report.as_json() | {"report": folder / "report.html"})
        return
    for line in summary_lines(report):
        print(line)
    print(f"written: {folder / 'report.html'}")


def failure_log_writer(folder: Path) -> Callable[[SimulatedRun, ScenarioResult], None]:
    """Return a function that writes the log of a failed scenario into ``folder``."""

    def write_log(simulation: SimulatedRun, result: ScenarioResult) -> None:
        name = re.sub(r"[^A-Za-z0-9=.]+", "-", result.scenario)
        model = simulation.controller.model
        plan = RunPlan(model.hand, model.gains, 1.0 / model.period, ())
        path = folder / f"{name}.mcap"
        path.unlink(missing_ok=True)
        recorder = Recorder.start(
            path, run_header(plan, simulation.controller, None, lockstep=True)
        )
        for entry, tick_output in simulation.recorded_ticks:
            recorder.send_record(pack_tick_record(entry, tick_output))
        recorder.close(result.problem)

    return write_log
