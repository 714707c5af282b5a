"""A window on the screen that shows pictures, by pygame."""

from __future__ import annotations

import os

import numpy as np

from snnrl.errors import ConfigError

NOT_SHOWN = ("offscreen", "evdev")  # drivers that SDL falls back to where there is no display


class Window:
    """Shows one picture after the other, at most so many a second.

    Raises:
        ConfigError: pygame is not installed, or there is no display.
    """

    def __init__(self, title: str, rate: float) -> None:
        try:
            import pygame
        except ImportError:
            raise ConfigError("render_mode", "human", 'needs pygame: pip install "snnrl[render]"') from None
        self._pygame, self.rate = pygame, rate
        try:
            pygame.display.init()
        except pygame.error as error:
            raise ConfigError("render_mode", "human", f"needs a display ({error}); rgb_array does not") from None
        if pygame.display.get_driver() in NOT_SHOWN and "SDL_VIDEODRIVER" not in os.environ:
            pygame.display.quit()
            raise ConfigError("render_mode", "human", "needs a display, and there is none; rgb_array does not")
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()

    def show(self, picture: np.ndarray) -> None:
        """uint8 [height, width, 3]; waits until the one before has been shown for long enough."""
        pygame = self._pygame
        screen = pygame.display.get_surface() or pygame.display.set_mode(picture.shape[1::-1])
        pygame.surfarray.blit_array(screen, picture.swapaxes(0, 1))
        pygame.event.pump()
        self._clock.tick(self.rate)
        pygame.display.flip()

    def close(self) -> None:
        self._pygame.display.quit()
