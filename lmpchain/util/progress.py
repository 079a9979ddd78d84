"""Progress bar of long work."""

from __future__ import annotations

from typing import Any, Self

from .arrays import check_flags

COUNT = "{desc}: {n:.0f} of {total}{unit} |{bar}| {elapsed}, {remaining} left"
PERCENT = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"
RATE = "{desc}: {percentage:3.0f}% |{bar}| {rate_fmt}, {remaining} left{postfix}"


class ProgressBar:
    """A progress bar on stderr during its `with` block, if progress is shown.

    Parameters
    ----------
    total : float
        Amount of work.
    text : str
        Name of the work, in front of the bar.
    unit : str
        Unit of the work, such as " samples", with its leading space.
    done : float
        Amount of work that was done before.
    layout : str
        Texts around the bar, as a format of tqdm: `COUNT`, `PERCENT` or `RATE`.
    delay_s : float
        Time before the bar appears, s. Shorter work shows no bar.
    shown : bool
        Whether to show the bar. If it is false, tqdm is not imported.

    Examples
    --------
    >>> with ProgressBar(3, "engines", shown=False) as bar:
    ...     bar.advance()
    ...     bar.reach(2.5)
    """

    def __init__(
        self,
        total: float,
        text: str = "",
        unit: str = "",
        *,
        done: float = 0,
        layout: str = COUNT,
        delay_s: float = 0.0,
        shown: bool = True,
    ):
        check_flags(progress=shown)
        self.total = total
        self._bar: Any = None
        if shown:
            # The import of tqdm takes longer than many runs.
            from tqdm.auto import tqdm

            self._bar = tqdm(
                total=total,
                desc=text,
                unit=unit,
                initial=done,
                leave=False,
                bar_format=layout,
                delay=delay_s,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: object, *_: object) -> None:
        if self._bar is not None:
            if error is None:
                self._bar.n = self._bar.total
                # Fast work has not displayed anything since the beginning.
                self._bar.refresh()
            self.close()

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()

    def advance(self, amount: float = 1) -> None:
        """Add an amount of finished work."""
        if self._bar is not None:
            self._bar.update(amount)

    def reach(self, done: float) -> None:
        """Set the amount of finished work."""
        if self._bar is not None:
            self._bar.update(done - self._bar.n)

    def describe(self, text: str) -> None:
        """Change the text in front of the bar."""
        if self._bar is not None:
            self._bar.set_description_str(text)

    def remark(self, text: str) -> None:
        """Change the text after the bar from its next update on; only `RATE` displays it."""
        if self._bar is not None:
            self._bar.set_postfix_str(text, refresh=False)
