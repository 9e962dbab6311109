"""A progress bar on stderr: sentences, tokens run, the share of tokens saved, time left."""

from __future__ import annotations

from typing import Any


class Meter:
    """Counts what is done; shows it only where ``enabled``.

    ``total`` is the number of sentences, None where it is unknown (then no time left is shown).
    """

    def __init__(self, total: int | None = None, enabled: bool = False) -> None:
        self.tokens_asked = 0
        self.tokens_run = 0
        self._finished = 0
        self._bar: Any = None
        if enabled:
            from tqdm import tqdm

            self._bar = tqdm(total=total, desc="scoring", unit=" sentences", mininterval=0.5)

    def begin(self, sentences: int, tokens: int) -> None:
        """A window of ``sentences`` holding ``tokens`` is about to be scored."""
        self._window = sentences
        self._window_tokens = tokens
        self._share = 0.0

    def part(self, share: float) -> Meter:
        """A meter for ``share`` of the window's work."""
        return _Part(self, share)

    def advance(self, share: float, tokens_run: int) -> None:
        """``share`` of the window's work is done, at the cost of ``tokens_run`` in the model."""
        self._share = min(1.0, self._share + share)
        self.tokens_run += tokens_run
        self._show(self._finished + int(self._share * self._window))

    def finish(self) -> None:
        """The window's scores are known."""
        self._finished += self._window
        self.tokens_asked += self._window_tokens
        self._show(self._finished)

    def _show(self, sentences: int) -> None:
        if self._bar is None:
            return
        asked = self.tokens_asked or self._share * self._window_tokens
        saved = 1 - self.tokens_run / asked if asked else 0.0
        self._bar.set_postfix_str(
            f"{self.tokens_run:,} tokens run, {max(saved, 0.0):.0%} saved", refresh=False
        )
        self._bar.update(max(0, sentences - self._bar.n))

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


class _Part(Meter):
    """Forwards to a whole meter what is done of a share of its window."""

    def __init__(self, whole: Meter, share: float) -> None:
        super().__init__()
        self._whole = whole
        self._part_share = share

    def advance(self, share: float, tokens_run: int) -> None:
        self._whole.advance(share * self._part_share, tokens_run)
