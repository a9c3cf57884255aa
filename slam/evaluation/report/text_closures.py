"""Tables about loop closures and what is related to them."""

from __future__ import annotations

from rich.table import Table

from slam.evaluation.metrics.relocalization import RelocalizationQuality
from slam.evaluation.place_recognition.closures import NO_TRUE_CANDIDATE, ClosureErrors, ClosureQuality, RevisitQuality
from slam.evaluation.place_recognition.discoveries import Discoveries
from slam.evaluation.place_recognition.place_pairs import OnlineQuality, PairQuality
from slam.evaluation.place_recognition.precision_recall import ScoreSweep
from slam.evaluation.place_recognition.reliability import SURE
from slam.evaluation.place_recognition.retrieval import RECALL_AT, RetrievalQuality
from slam.evaluation.report.text_tables import UNDEFINED, counts, fraction, number, pairs_table


def closure_table(quality: ClosureQuality, retrieval: RetrievalQuality | None = None) -> Table:
    """Candidates by the stage of their decision, precision, recall, errors, and the retrieval stage alone."""
    rows = {
        "candidates, accepted, in the graph": f"{quality.candidate_count}, {quality.accepted_count}, "
        f"{quality.inserted_count}",
        "decided at stage": counts(quality.stage_counts),
    }
    if quality.true_count is not None and quality.false_count is not None:
        precision = fraction(quality.precision, quality.true_count, quality.true_count + quality.false_count)
        rows["precision"] = precision + (f", {quality.undecided_count} undecided" if quality.undecided_count else "")
    rows["retrieved, propagated, propagated back"] = _discoveries(quality.discoveries)
    if quality.reliability is not None and quality.reliability.sure_count:
        sure = quality.reliability
        share = fraction(sure.sure_right / sure.sure_count, sure.sure_right, sure.sure_count)
        rows[f"right with a probability of {SURE:g}"] = share
    if quality.revisits is not None:
        rows["recall"] = _recall(quality.revisits)
        rows["missed revisits by stage"] = _missed(quality.revisits)
    if quality.errors is not None:
        rows["error of the true ones"] = _closure_error(quality.errors)
    if quality.revisits is not None:
        rows["by a threshold on the score"] = _sweep(quality.revisits.sweep)
        if retrieval is not None:
            rows["recall of descriptors where asked"] = _retrieval(retrieval, quality.revisits.revisit_count)
    return pairs_table("Loop closures", rows)


def literature_table(pairs: PairQuality, online: OnlineQuality) -> Table:
    """Place recognition by the two protocols of papers."""
    claims = (
        f"candidates claim {pairs.claimed_positive_count} of {pairs.positive_count} positive and "
        f"{pairs.claimed_negative_count} of {pairs.negative_count} negative pairs"
    )
    recall = fraction(online.recall_at_1, online.found_count, online.revisit_count)
    return pairs_table(
        "Place recognition as papers measure it",
        {
            "pairs": f"{_sweep(pairs.sweep)}; {claims}",
            "online": f"{_sweep(online.sweep)}; recall at 1 {recall}; {online.query_count} queries",
        },
    )


def relocalization_table(quality: RelocalizationQuality) -> Table:
    """How often the robot was lost, and what became of it."""
    losses, fixes = quality.loss_count, quality.fix_count
    decided = losses - quality.undecided_count
    error_m, error_deg = quality.median_error_m, quality.median_error_deg
    methods = {
        "closure": "of the closure",
        "map": "where the truth has the map",
        "trajectory": "after the alignment of this drive",
    }
    rows = {
        "lost, found again": f"{losses}, {fixes}; {_percent(quality.lost_time_ratio)} of the time lost",
        "right fixes": fraction(quality.success_rate, quality.right_count, decided),
        "wrong fixes": fraction(quality.false_relocalization_rate, quality.wrong_count, decided),
    }
    if fixes:
        rows["time to a fix"] = f"median {number(quality.median_seconds)} s, max {number(quality.max_seconds)} s"
        rows["travel to a fix"] = (
            f"median {number(quality.median_distance_m)} m, max {number(quality.max_distance_m)} m"
        )
    if error_m is not None and error_deg is not None:
        rows["error of a fix"] = (
            f"median {error_m:.3f} m, {error_deg:.3f} deg; 95 % {number(quality.p95_error_m)} m, "
            f"{number(quality.p95_error_deg)} deg ({methods[quality.method]})"
        )
    return pairs_table("Relocalization", rows)


def _discoveries(discoveries: Discoveries) -> str:
    text = f"{discoveries.found}, {discoveries.followed}, {discoveries.led_back}"
    if discoveries.independent is None:
        return text
    text += f"; {discoveries.independent} independent discoveries, {discoveries.independent_false} false"
    share = discoveries.largest_false_share
    return text if share is None else f"{text}: at most {100.0 * share:.1f} % false, with 95 % confidence"


def _sweep(sweep: ScoreSweep | None) -> str:
    return (
        f"average precision {number(sweep.average_precision if sweep else None)}, "
        f"largest F1 {number(sweep.f1_max if sweep else None)}, "
        f"extended precision {number(sweep.extended_precision if sweep else None)}, "
        f"recall at full precision {number(sweep.recall_at_full_precision if sweep else None)}"
    )


def _retrieval(retrieval: RetrievalQuality, revisit_count: int) -> str:
    if not retrieval.query_count:
        return f"{UNDEFINED} ({retrieval.note})"
    recalls = [f"{_percent(retrieval.recall_at(k))} at {k}" for k in RECALL_AT]
    note = f" ({retrieval.note})" if retrieval.note else ""
    return f"{', '.join(recalls)}, asked at {retrieval.query_count} of {revisit_count} revisits{note}"


def _percent(share: float | None) -> str:
    return UNDEFINED if share is None else f"{100.0 * share:.2f} %"


def _recall(revisits: RevisitQuality) -> str:
    if not revisits.revisit_count:
        return f"{UNDEFINED} (no revisit)"
    directions = ", ".join(
        f"{name} {UNDEFINED}"
        if (recall := revisits.recall_of(name)) is None
        else f"{name} {100.0 * recall:.2f} % of {count}"
        for name, count in revisits.revisit_counts.items()
    )
    share = f"{100.0 * revisits.recalled_count / revisits.revisit_count:.2f} %"
    associated = ""
    if revisits.associated_count and revisits.recognised is not None:
        associated = f"; with the {revisits.associated_count} by data association {100.0 * revisits.recognised:.2f} %"
    return f"{share} ({revisits.recalled_count} of {revisits.revisit_count} revisits; {directions}){associated}"


def _missed(revisits: RevisitQuality) -> str:
    texts = []
    for stage, count in revisits.missed_by_stage.items():
        detail = (
            f" ({revisits.missed_without_candidate_count} without any candidate, {revisits.missed_at_place_count} with "
            "the right place)"
        )
        texts.append(f"{stage} {count}{detail if stage == NO_TRUE_CANDIDATE else ''}")
    return ", ".join(texts) or "none"


def _closure_error(errors: ClosureErrors) -> str:
    spread = errors.intra_revisit_std_m
    return (
        f"median {errors.median_translation_m:.3f} m, {errors.median_rotation_deg:.3f} deg; "
        f"in the plane {errors.median_planar_m:.3f} m, {errors.median_heading_deg:.3f} deg; "
        f"95 % {errors.p95_translation_m:.3f} m, {errors.p95_rotation_deg:.3f} deg; "
        f"spread within a revisit {UNDEFINED if spread is None else f'{spread:.3f} m'}"
    )
