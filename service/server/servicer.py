"""The methods of the service, by the names they have on the wire."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass

from service.proto.planner.v1 import planner_pb2 as wire
from service.server.keeping import Keeping
from service.server.perceiving import Perceiving
from service.server.planning import Planning
from service.server.uploading import Uploading
from service.trust.rpc import Context


@dataclass(frozen=True)
class Servicer:
    """Hands every method to the one that answers it."""

    planning: Planning
    uploading: Uploading
    perceiving: Perceiving
    keeping: Keeping

    def Plan(self, message: wire.PlanRequest, context: Context) -> AsyncIterator[wire.PlanResponse]:
        return self.planning.plan(message, context)

    async def UploadCloud(
        self, messages: AsyncIterator[wire.UploadCloudRequest], context: Context
    ) -> wire.UploadCloudResponse:
        return await self.uploading.upload(messages, context)

    def BuildScene(self, message: wire.BuildSceneRequest, context: Context) -> AsyncIterator[wire.BuildSceneResponse]:
        return self.perceiving.build_scene(message, context)

    async def GetScene(self, message: wire.GetSceneRequest, context: Context) -> wire.GetSceneResponse:
        return await self.perceiving.scene(message, context)

    async def Detect(self, message: wire.DetectRequest, context: Context) -> wire.DetectResponse:
        return await self.perceiving.detect(message, context)

    async def Verify(self, message: wire.VerifyRequest, context: Context) -> wire.VerifyResponse:
        return await self.keeping.verify(message, context)

    async def ListRobots(self, message: wire.ListRobotsRequest, context: Context) -> wire.ListRobotsResponse:
        return await self.keeping.robots(message, context)

    def GetPlan(self, message: wire.GetPlanRequest, context: Context) -> AsyncIterator[wire.GetPlanResponse]:
        return self.keeping.get_plan(message, context)

    async def ReviewPlan(self, message: wire.ReviewPlanRequest, context: Context) -> wire.ReviewPlanResponse:
        return await self.keeping.review(message, context)

    async def GetStatus(self, message: wire.GetStatusRequest, context: Context) -> wire.GetStatusResponse:
        return await self.keeping.status(message, context)
