"""What the parameters of faults may be, with their units."""

from typing import Annotated

from pydantic import Field

Part = Annotated[float, Field(ge=0.0, le=1.0, description="part of the drive")]
Share = Annotated[float, Field(ge=0.0, le=1.0, description="share")]
Seconds = Annotated[float, Field(ge=-1e6, le=1e6, description="s")]
Duration = Annotated[float, Field(ge=0.0, le=1e6, description="s")]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0, description="deg")]
Factor = Annotated[float, Field(ge=-1e3, le=1e3, description="factor")]
Metres = Annotated[float, Field(ge=-1e6, le=1e6, description="m")]
Sigma = Annotated[float, Field(ge=0.0, le=1e3, description="m")]
Hertz = Annotated[float, Field(ge=1e-3, le=1e3, description="Hz")]
Number = Annotated[int, Field(ge=1, le=1_000_000, description="number")]
