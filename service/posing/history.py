"""The poses of a session: the current one, undo and redo."""

from __future__ import annotations

from dataclasses import dataclass, field

from service.posing.drag import Drag, LedPose, Move

MOST_UNDO = 200


@dataclass
class PoseHistory:
    """Checked poses of a session, and the drag that leads it now.

    Attributes:
        pose: the current pose.
        revision: grows with every change of the pose.
    """

    pose: LedPose
    revision: int = 1
    _undo: list[LedPose] = field(default_factory=list)
    _redo: list[LedPose] = field(default_factory=list)
    _drag: Drag | None = None
    _is_dragging: bool = False

    @property
    def undo_steps(self) -> int:
        """How often ``undo`` goes back."""
        return len(self._undo)

    @property
    def redo_steps(self) -> int:
        """How often ``redo`` goes forward."""
        return len(self._redo)

    def measure_move(self, drag: Drag) -> Move:
        """Return how far the targets of a drag are from those of the event before."""
        return Move.between(self._drag or Drag(), drag)

    def take(self, drag: Drag, pose: LedPose, *, is_last: bool) -> None:
        """Take over the pose of a drag's event; all events of a drag are one step of undo."""
        if not self._is_dragging:
            self._remember()
        self._drag, self._is_dragging = (None, False) if is_last else (drag, True)
        self._change(pose)

    def set(self, pose: LedPose) -> None:
        """Take over a given pose."""
        self.end_drag()
        self._remember()
        self._change(pose)

    def undo(self) -> bool:
        """Go back to the pose before the latest drag or given pose; False where there is none."""
        return self._go(self._undo, self._redo)

    def redo(self) -> bool:
        """Take the latest undo back; False where there is none."""
        return self._go(self._redo, self._undo)

    def end_drag(self) -> None:
        """End the drag: the next one is a step of undo of its own."""
        self._drag, self._is_dragging = None, False

    def _go(self, there: list[LedPose], back: list[LedPose]) -> bool:
        self.end_drag()
        if not there:
            return False
        back.append(self.pose)
        self._change(there.pop())
        return True

    def _remember(self) -> None:
        self._undo.append(self.pose)
        del self._undo[:-MOST_UNDO]
        self._redo.clear()

    def _change(self, pose: LedPose) -> None:
        self.revision += pose.numbers != self.pose.numbers
        self.pose = pose
