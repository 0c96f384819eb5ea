"""A window that shows frames at the speed they were lived at; needs pygame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

if TYPE_CHECKING:
    import pygame


class Window:
    """A window for pictures of one size.

    It opens at the first picture. Once its user has closed it, pictures are dropped, and time is no longer waited for.

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
            raise DependencyNotInstalled("render_mode=\"human\" needs pygame: pip install 'wtg-gym[render]'") from error
        self._title, self._fps = title, fps
        self._clock = pygame.time.Clock()
        self._surface: pygame.Surface | None = None
        #: Whether there is nothing left to show pictures in.
        self.is_closed = False

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3), and wait until it is due.

        Raises:
            RuntimeError: there is no display.
        """
        import pygame

        if self.is_closed:
            return
        height, width = picture.shape[:2]
        if self._surface is None:
            self._surface = self._open(width, height)
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        self._surface.blit(pygame.image.frombuffer(picture.tobytes(), (width, height), "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)

    def _open(self, width: int, height: int) -> pygame.Surface:
        import pygame

        try:
            pygame.display.init()
            surface = pygame.display.set_mode((width, height))
        except pygame.error as error:
            raise RuntimeError(
                f'render_mode="human" found no display to open a window on ({error}); use render_mode="rgb_array"'
            ) from error
        pygame.display.set_caption(self._title)
        return surface

    def close(self) -> None:
        """Close the window; no other one opens."""
        self.is_closed = True
        if self._surface is not None:
            import pygame

            self._surface = None
            pygame.display.quit()
