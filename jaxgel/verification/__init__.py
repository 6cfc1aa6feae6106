"""How far numbers can be trusted: what a cloud resolves, error bars from several clouds, and from uncertain inputs."""

from .resolution import Resolution, resolution

__all__ = ["Resolution", "resolution"]
