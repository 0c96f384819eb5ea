"""A window that shows frames in real time; needs pygame."""

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from wtg_gym.extras import install_advice


class Window:
    """A window for pictures of one size, `fps` per second at most; a DependencyNotInstalled if pygame is missing.

    It opens at the first picture. Once its user has closed it, pictures are dropped without waiting.
    """

    def __init__(self, title: str, fps: int) -> None:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled(f'render_mode="human" needs pygame; {install_advice("render")}') from error
        self._pygame, self._title, self._fps = pygame, title, fps
        self._clock = pygame.time.Clock()
        self._surface: Any = None
        #: Whether the window was closed, by its user or by :meth:`close`.
        self.is_closed = False

    def __reduce__(self) -> Any:
        # A copy opens a window of its own.
        return Window, (self._title, self._fps)

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3), and wait until it is due; a RuntimeError if there is no display."""
        pygame, size = self._pygame, (picture.shape[1], picture.shape[0])
        try:
            pygame.display.init()
            self._surface = self._surface or pygame.display.set_mode(size)
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
