"""Documents generated from the code: the interface control document and the JSON schemas."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel


def schema_text(model: type[BaseModel]) -> str:
    """JSON schema of a file that ``model`` validates."""
    schema: dict[str, Any] = model.model_json_schema(by_alias=True)
    return json.dumps(schema, indent=2) + "\n"
