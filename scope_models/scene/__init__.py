"""Stars, detectors, motions and the scenes that hold them."""

from scope_models.scene._files import read_detector, read_scene
from scope_models.scene.common import CommonMotion
from scope_models.scene.detector import ZERO_POINTS, Detector
from scope_models.scene.motion import K2Roll, Motion, MotionStatistics
from scope_models.scene.presets import PRESETS, register_preset
from scope_models.scene.scene import Scene, Star

__all__ = [
    "PRESETS", "ZERO_POINTS", "CommonMotion", "Detector", "K2Roll", "Motion", "MotionStatistics",
    "Scene", "Star", "read_detector", "read_scene", "register_preset",
]  # fmt: skip
