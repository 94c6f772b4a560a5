"""The right column: scores with their yardsticks, and how they have changed since the pin."""

from collections.abc import Sequence

from nicegui import ui

from designlab.app.studio.scoring import ScoreRow


class Scores:
    """Table of scores and a line that says how fresh they are."""

    def __init__(self) -> None:
        with ui.element("section").classes("scores").props('aria-label="Scores"'):
            ui.label("Scores").classes("heading").props('role="heading" aria-level="2"')
            self._state = ui.label("").classes("state").props('aria-live="polite" id="score-state"')
            self._table = ui.element("div").classes("score-rows")

    def say(self, text: str, *, stale: bool = True) -> None:
        """Say how fresh the scores are."""
        self._state.set_text(text)
        self._table.classes(add="stale" if stale else "", remove="" if stale else "stale")

    def show(self, rows: Sequence[ScoreRow], *, pinned: bool) -> None:
        """Show scores."""
        self._table.clear()
        with self._table:
            for row in rows:
                self._row(row, pinned)

    def _row(self, row: ScoreRow, pinned: bool) -> None:
        with ui.element("div").classes("score").props(f'data-score="{row.name}"'):
            ui.label(row.title).classes("title")
            ui.label(row.value).classes("value")
            word = row.verdict.partition(",")[0]
            ui.label(row.verdict).classes(f"verdict {word}")
            if pinned:
                ui.label(row.change).classes("change clear" if row.clear else "change")
            if row.meaning or row.limits:
                ui.tooltip("\n".join(filter(None, (row.meaning, row.limits)))).props(
                    "max-width=22rem delay=400"
                )
