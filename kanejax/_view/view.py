"""Robots and their motions in the browser."""

import contextlib
import html
import io
import os
import socket
import threading
from collections.abc import Sequence
from typing import final

from kanejax._model.model import Model
from kanejax._view.motions import Motions, stage_of
from kanejax._view.page import Page
from kanejax._view.panel import Panel
from kanejax._view.shape import ViewError, view_package
from kanejax._view.stage import Stage


@final
class View:
    """A page in the browser; in a notebook it is shown below its cell.

    Attributes:
        url: where the page is.
        notes: in sentences, what could not be shown.
    """

    def __init__(self, stage: Stage, notes: tuple[str, ...], host: str, port: int) -> None:
        """Serve a page; `view` makes one."""
        viser = view_package("viser")
        # viser looks for a port without end on a host that this machine does not have.
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            try:
                probe.bind((host, 0))
            except OSError as error:
                raise ViewError(f"host {host!r} is no address of this machine ({error}); 127.0.0.1 is seen by it alone") from error
        before = set(threading.enumerate())
        # viser prints where it is, and that it stops.
        with contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(host=host, port=port, label="kanejax", verbose=False)
        self._serving = set(threading.enumerate()) - before
        self._server.gui.main_panel.dock_right()
        self._server.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        self._page = Page(self._server, stage)
        self._panel = Panel(self._server, stage, self._page)
        self.url: str = f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"
        self.notes = notes

    @property
    def time(self) -> float:
        """The time of the motion that is shown [s]."""
        return self._panel.time

    @property
    def playing(self) -> bool:
        """Whether the motion is played."""
        return self._panel.playing

    def show_time(self, t: float) -> None:
        """Show the motion at a time [s], from 0 to its duration."""
        self._panel.show_time(t)

    def play(self) -> None:
        """Play the motion."""
        self._panel.play()

    def pause(self) -> None:
        """Stop playing."""
        self._panel.play(False)

    def close(self) -> None:
        """Stop serving the page."""
        self._panel.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
            # It says so at the end of its thread, for which it does not wait long.
            for thread in self._serving:
                thread.join(timeout=10.0)

    def __enter__(self) -> "View":
        """The page itself, which is closed when the block is left."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def __repr__(self) -> str:
        """Say where it is."""
        return f"<view at {self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{html.escape(self.url)}" style="width: 100%; height: 480px; border: 0"></iframe>'


def view(
    robot: str | os.PathLike[str] | Model,
    trajectory: Motions = None,
    *,
    rows: Sequence[int] | None = None,
    reference: Motions = None,
    packages: Sequence[str | os.PathLike[str]] = (),
    strict: bool = False,
    repair: bool = False,
    allow_unphysical: bool = False,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> View:
    """Show a robot and its motion on a page of the browser.

    Links look as the visuals of the URDF or the geoms of the MJCF say. A link without them is drawn as its frame and the ellipsoid
    of its inertia: the solid one of uniform density with the link's mass and principal moments. Meshes are read from STL, OBJ and
    Collada files beside the robot's file or below, and in packages; those that cannot be read are listed in `notes`.

    Args:
        robot: path of a URDF or MJCF file, or its XML; or a model, which has no shapes.
        trajectory: a Trajectory, OptimalMotion or Log, or a mapping with arrays "ts" and "q", perhaps "u" and "tau"; a path of an
            NPZ file or Zarr store of `kanejax simulate`, of the motion.npz of `kanejax optimize`, or of a log that `read_log`
            reads with its usual columns; or a sequence of these. None: there is a slider for each joint.
        rows: numbers of the trajectories to show side by side, of each batch; None: the first, and all runs of a log.
        reference: a motion, given like a trajectory, that a translucent robot makes.
        packages: folders of packages of ROS for package:// in a URDF, beyond those above its file that have the package's name.
        strict: as in `load`, and so are the next two; what is not modelled is seen all the same.
        repair: as in `load`.
        allow_unphysical: as in `load`.
        host: address to serve the page at; the default is seen by this machine alone.
        port: of the page; if it is taken, the next one that is free.

    Returns:
        The page, until its `close` is called or the program ends.

    Raises:
        KanejaxError: the robot or the trajectory cannot be read, or do not go together.
    """
    stage, notes = stage_of(
        robot,
        trajectory,
        rows=rows,
        reference=reference,
        packages=packages,
        strict=strict,
        repair=repair,
        allow_unphysical=allow_unphysical,
    )
    return View(stage, notes, host, port)
