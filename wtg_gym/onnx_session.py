"""How onnxruntime opens a policy: alike where it is evaluated and where a stranger's is played, so that both give the
same numbers.
"""

from __future__ import annotations

import os
from typing import Any


def open_session(content: bytes) -> Any:
    """Return onnxruntime's session of an .onnx file's content, on one thread and without its log.

    Raises:
        ImportError: onnxruntime is not installed.
        Exception: onnxruntime cannot load it; its exceptions share no other base.
    """
    # onnxruntime would keep a file and a thread to report its use.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # Never onnxruntime's own format, whatever the file begins with.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


__all__ = ["open_session"]
