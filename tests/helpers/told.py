"""What long work tells while it goes on."""


class Told(list[tuple[str, float]]):
    """What was being done, and the share of the whole that was done, at every call."""

    def __call__(self, what: str, done: int, total: int) -> None:
        """Note a call of `designlab.core.types.Progress`."""
        self.append((what, done / total))

    def assert_only_rises(self) -> None:
        """Check that the share begins at 0, never falls and is 1 at the end alone."""
        shares = [share for _, share in self]
        assert shares == sorted(shares)
        assert (shares[0], shares[-1]) == (0.0, 1.0)
        assert shares.count(1.0) == 1

    @property
    def said(self) -> list[str]:
        """What was being done, each once, in the order of its first mention."""
        return list(dict.fromkeys(what for what, _ in self))
