"""A window that shows frames in real time; needs pygame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from wtg_gym.extras import install_advice

if TYPE_CHECKING:
    import pygame


class Window:
    """A window for pictures of one size.

    It opens at the first picture. Once its user has closed it, pictures are dropped without waiting.

    Args:
        title: of the window.
        fps: pictures per second at most.

    Raises:
        DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, title: str, fps: int) -> None:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled(f'render_mode="human" needs pygame; {install_advice("render")}') from error
        self._pygame = pygame
        self._title, self._fps = title, fps
        self._clock = pygame.time.Clock()
        self._surface: pygame.Surface | None = None
        #: Whether the window was closed, by its user or by :meth:`close`.
        self.is_closed = False

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3), and wait until it is due.

        Raises:
            RuntimeError: no display was found.
        """
        if self.is_closed:
            return
        pygame, size = self._pygame, (picture.shape[1], picture.shape[0])
        if self._surface is None:
            try:
                pygame.display.init()
                self._surface = pygame.display.set_mode(size)
            except pygame.error as error:
                raise RuntimeError(
                    f'render_mode="human" found no display to open a window on ({error}); use render_mode="rgb_array"'
                ) from error
            pygame.display.set_caption(self._title)
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        self._surface.blit(pygame.image.frombuffer(picture.tobytes(), size, "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window; no other one opens."""
        self.is_closed = True
        if self._surface is not None:
            self._surface = None
            self._pygame.display.quit()
