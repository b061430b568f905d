"""The last R blocks and their sum, without adding all of them up again whenever one comes and one goes.

A queue of two stacks: recent blocks are summed as they come; when the older ones are used up, the recent ones take
their place as sums of each block with all that follow it. Every block enters two sums at most, however long the
window is, and nothing is ever subtracted.
"""

from collections import deque
from collections.abc import Iterable

from creak.judgement import Block
from creak.records import Complex


class Window:
    """The last R blocks.

    Parameters
    ----------
    size : int
        R, one or more.
    blocks : iterable of Block
        What it begins with, oldest first; more than R push the oldest out.
    older : int
        How many of those an earlier window counted as older: its sums then are this one's to the last bit.
    """

    def __init__(self, size: int, blocks: Iterable[Block] = (), older: int = 0) -> None:
        self.blocks: deque[Block] = deque(maxlen=size)
        self._older: list[Block] = []  # sums of a block and the older ones after it, the oldest on top
        self._recent: Block | None = None
        for block in blocks:
            if older and len(self.blocks) == older:
                self._flip()
                older = 0
            self.push(block)

    def __len__(self) -> int:
        """Number of blocks in it."""
        return len(self.blocks)

    @property
    def older(self) -> int:
        """How many of its blocks are summed as older ones."""
        return len(self._older)

    @property
    def turns(self) -> bool:
        """True if the next block makes all the others older ones."""
        return len(self.blocks) == self.blocks.maxlen and not self._older

    def push(self, block: Block) -> None:
        """Take a block in, and the oldest out if the window is full."""
        if self.turns:
            self._flip()
        if len(self.blocks) == self.blocks.maxlen:
            self._older.pop()
        self.blocks.append(block)
        self._recent = block if self._recent is None else self._recent + block

    @property
    def total(self) -> Block:
        """Sum of the blocks; there must be one."""
        if self._recent is None:
            raise ValueError("an empty window has no sum")
        return self._older[-1] + self._recent if self._older else self._recent

    def refer(self, about: Complex) -> None:
        """Take the residuals of all blocks about another matrix, ``(F, n, q)``."""
        self.blocks = deque((block.about(about) for block in self.blocks), self.blocks.maxlen)
        self._older = [block.about(about) for block in self._older]
        self._recent = None if self._recent is None else self._recent.about(about)

    def _flip(self) -> None:
        for block in reversed(self.blocks):
            self._older.append(block + self._older[-1] if self._older else block)
        self._recent = None
