"""The panel beside the scene: time, what is shown, joints, plots; and the clock that plays a motion."""

import threading
import time
from typing import Any

from kanejax._view.joint_sliders import JointSliders
from kanejax._view.page import Page
from kanejax._view.plots import Plots
from kanejax._view.stage import Stage

# Pictures a second that are asked of the browser, and how many of them a plot stays as it is.
_RATE, _PLOTS_EACH = 30.0, 6
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5")


class Panel:
    """Controls of a page; one lock keeps callbacks, which come from several threads, apart."""

    def __init__(self, server: Any, stage: Stage, page: Page) -> None:
        """Put the controls into the panel, and start the clock."""
        self._stage, self._page, self._gui = stage, page, server.gui
        self._lock, self._closed, self._playing = threading.Lock(), threading.Event(), threading.Event()
        self._t = 0.0
        self.slider: Any = None
        self.plots: Plots | None = None
        self.joints: JointSliders | None = None
        if stage.tracks:
            self._add_time()
        self._add_toggles()
        if stage.tracks:
            self.plots = Plots(self._gui, stage)
        else:
            self.joints = JointSliders(self._gui, stage.scene.model, self._posed)
        if stage.scene.notes:
            with self._gui.add_folder("notes", expand_by_default=False):
                self._gui.add_markdown("\n".join(f"- {_plain(note)}" for note in stage.scene.notes))
        self._clock = threading.Thread(target=self._run, daemon=True)
        self._clock.start()

    @property
    def time(self) -> float:
        """The time that is shown [s]."""
        return self._t

    @property
    def playing(self) -> bool:
        """Whether the clock runs."""
        return self._playing.is_set()

    def show_time(self, t: float, *, plots: bool = True) -> None:
        """Show another time."""
        with self._lock:
            self._t = min(max(float(t), 0.0), self._stage.duration)
            ghosts = None if self._stage.reference is None else self._stage.ghost_coordinates(self._t)
            self._page.move(self._stage.coordinates(self._t), ghosts)
            if self.plots is not None and plots:
                self.plots.show_time(self._t)
        if self.slider is not None:
            self.slider.value = self._t

    def play(self, playing: bool = True) -> None:
        """Play, from the beginning if the end is shown, or pause."""
        if not self._stage.tracks:
            return
        if playing and self._t >= self._stage.duration:
            self.show_time(0.0)
        self._button.label = "pause" if playing else "play"
        if playing:
            self._playing.set()
            return
        self._playing.clear()
        self.show_time(self._t)

    def close(self) -> None:
        """Stop the clock."""
        self._closed.set()
        self._playing.set()
        self._clock.join(timeout=2.0)

    def _posed(self, q: Any) -> None:
        with self._lock:
            self._page.move(q[None], None)

    def _add_time(self) -> None:
        duration = max(self._stage.duration, 1e-9)
        with self._gui.add_folder("time"):
            self.slider = self._gui.add_slider("time [s]", 0.0, duration, duration / 1000.0, 0.0)
            self._button = self._gui.add_button("play")
            self._speed = self._gui.add_dropdown("speed", SPEEDS, initial_value="1")
            self._loop = self._gui.add_checkbox("repeat", True)
        # Without a client it was not the user who moved it.
        self.slider.on_update(lambda event: self.show_time(self.slider.value) if event.client is not None else None)
        self._button.on_click(lambda _: self.play(not self.playing))

    def _add_toggles(self) -> None:
        with self._gui.add_folder("show"):
            labels = {"shapes": True, "ellipsoids": False, "frames": False, "centers": False}
            words = {"shapes": "shapes", "ellipsoids": "ellipsoids of inertia", "frames": "frames", "centers": "mass centres"}
            boxes = {name: self._gui.add_checkbox(words[name], shown) for name, shown in labels.items()}

            def update(_: Any) -> None:
                with self._lock:
                    self._page.show_layers(**{name: box.value for name, box in boxes.items()})

            for box in boxes.values():
                box.on_update(update)
            if self._stage.reference is not None:
                ghost = self._gui.add_checkbox("reference", True)
                ghost.on_update(lambda _: self._page.show_reference(ghost.value))

    def _run(self) -> None:
        count, before = 0, time.perf_counter()
        while self._playing.wait() and not self._closed.is_set():
            now = time.perf_counter()
            # After a pause the clock goes on from where it was.
            elapsed = min(now - before, 2.0 / _RATE)
            before, count = now, count + 1
            t = self._t + elapsed * float(self._speed.value)
            if t >= self._stage.duration:
                if not self._loop.value:
                    self._t = self._stage.duration
                    self.play(False)
                    continue
                t = 0.0
            self.show_time(t, plots=count % _PLOTS_EACH == 0)
            self._closed.wait(max(0.0, 1.0 / _RATE - (time.perf_counter() - now)))


def _plain(note: str) -> str:
    """A sentence with what Markdown takes for marks escaped: names come from files of others."""
    return "".join(f"\\{mark}" if mark in "\\`*_{}[]()<>#+-!|~" else mark for mark in note)
