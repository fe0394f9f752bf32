// Starts the page and connects it to keyboard, pointer, URL and tests.
import { Vector3 } from "three";
import { App } from "./app";
import { el } from "./dom";
import { VIEWS, View } from "./stage";

function keys(app: App): void {
  const acts: Record<string, () => void> = {
    " ": () => app.toggle(), ArrowLeft: () => app.step(-1), ArrowRight: () => app.step(1), ",": () => app.stepFrame(-1),
    ".": () => app.stepFrame(1), "[": () => app.stepPhase(-1), "]": () => app.stepPhase(1), Home: () => app.seek(app.start),
    End: () => app.seek(app.end), "+": () => app.shiftSpeed(1), "=": () => app.shiftSpeed(1), "-": () => app.shiftSpeed(-1),
    n: () => app.nextCheck(), x: () => app.setXray(!app.isXray), d: () => app.setTheme(app.theme === "dark" ? "light" : "dark"),
    l: () => document.body.classList.toggle("unlabelled"), s: () => app.savePicture(), i: () => app.togglePanel(),
    h: () => { app.isFollowing = !app.isFollowing; if (app.isFollowing) app.show("hand"); },
    "?": () => { app.help.hidden = !app.help.hidden; },
    Escape: () => { app.help.hidden = true; app.chooseCheck(-1); app.showPoses(-1); },
  };
  VIEWS.forEach((view, i) => { acts[String(i + 1)] = () => app.show(view); });
  for (const layer of app.layers) acts[layer.key] = () => app.toggle(layer);
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    // A focused button would take the space bar for itself.
    if (document.activeElement instanceof HTMLButtonElement) document.activeElement.blur();
    act();
  });
}

function pointer(app: App): void {
  const canvas = app.stage.renderer.domElement;
  const under = (event: MouseEvent): { name: string; point: Vector3 } | undefined => {
    const solids = app.solids().filter(({ mesh }) => {
      let isSeen = true;
      mesh.traverseAncestors((parent) => { isSeen &&= parent.visible; });
      return isSeen;
    });
    const [hit] = app.stage.ray(event.clientX, event.clientY).intersectObjects(solids.map(({ mesh }) => mesh), false);
    return hit && { name: solids.find(({ mesh }) => mesh === hit.object)!.name, point: hit.point };
  };
  const name = (event: MouseEvent): void => {
    const found = event.buttons === 0 ? under(event) : undefined;
    app.tip.hidden = !found;
    if (!found) return;
    const { x, y, z } = found.point;
    app.tip.textContent = `${found.name}  (${x.toFixed(2)}, ${y.toFixed(2)}, ${z.toFixed(2)}) m`;
    const rect = canvas.getBoundingClientRect();
    app.tip.style.transform = `translate(${event.clientX - rect.left + 14}px, ${event.clientY - rect.top + 12}px)`;
  };
  canvas.addEventListener("pointermove", name);
  // Where nothing hovers, a tap names.
  canvas.addEventListener("click", name);
  canvas.addEventListener("pointerleave", () => { app.tip.hidden = true; });
  canvas.addEventListener("dblclick", (event) => {
    const found = under(event);
    if (found) app.stage.focus(found.point);
  });
}

// #t=1.5&camera=front&layers=robot,pieces&theme=dark&check=0&pose=12&xray=1&panel=0&bars=0&play=1
function followHash(app: App): void {
  const wanted = new URLSearchParams(location.hash.slice(1));
  const theme = wanted.get("theme");
  if (theme === "dark" || theme === "light") app.setTheme(theme);
  if (wanted.get("panel")) document.body.classList.toggle("wide", wanted.get("panel") === "0");
  if (wanted.get("bars")) document.body.classList.toggle("bare", wanted.get("bars") === "0");
  const layers = wanted.get("layers")?.split(",");
  if (layers) for (const layer of app.layers) app.setLayer(layer, layers.includes(layer.name));
  for (const name of wanted.get("without")?.split(",") ?? []) {
    const layer = app.layers.find((entry) => entry.name === name);
    if (layer) app.setLayer(layer, false);
  }
  app.stage.resize();
  const t = Number(wanted.get("t") ?? NaN);
  if (Number.isFinite(t)) app.seek(t);
  const camera = wanted.get("camera") as View | null;
  if (camera && VIEWS.includes(camera)) app.show(camera, true);
  if (wanted.get("xray")) app.setXray(wanted.get("xray") === "1");
  const check = Number(wanted.get("check") ?? NaN);
  if (Number.isInteger(check)) app.chooseCheck(check);
  const pose = app.result.pose_graph?.poses[Number(wanted.get("pose") ?? NaN)];
  if (pose) app.showPoses(pose.phase, Number(wanted.get("pose")));
  if (wanted.get("play") === "1") app.play(true);
}

function start(): void {
  const app = new App();
  keys(app);
  pointer(app);
  followHash(app);
  window.addEventListener("hashchange", () => followHash(app));
  const hook = {
    ready: true,
    verdict: app.result.verdict,
    counts: Object.fromEntries(app.layers.map((layer) => [layer.name, layer.count])),
    get time(): number { return app.time; },
    get duration(): number { return app.end - app.start; },
    plots: app.timeline.plots.map((plot) => plot.lines),
    gaps: app.result.gaps,
    ground: app.ground,
    get busy(): boolean { return app.stage.isBusy; },
    get frames(): number { return app.stage.frames; },
    get drawCalls(): number { return app.stage.renderer.info.render.calls; },
    get camera(): number[] { return [...app.stage.camera.position.toArray(), ...app.stage.controls.target.toArray()]; },
    setTime(t: number): void { app.seek(t); app.stage.render(); },
    setCamera(view: View): void { app.show(view, true); app.stage.render(); },
    setTheme(theme: "dark" | "light"): void { app.setTheme(theme); app.stage.render(); },
    // Page pixel of a link's origin, a solid's centre or a world point.
    project(what: string | number[]): number[] | null {
      if (Array.isArray(what)) return app.stage.pixel(new Vector3().fromArray(what));
      const solid = app.solids().find(({ name }) => name === what);
      if (solid) {
        solid.mesh.updateWorldMatrix(true, false);
        return app.stage.pixel(solid.mesh.geometry.boundingSphere!.center.clone().applyMatrix4(solid.mesh.matrixWorld));
      }
      const place = app.motion.place(what, app.time);
      return place ? app.stage.pixel(place) : null;
    },
    angle(index: number): number {
      return 2 * Math.acos(Math.min(1, Math.abs(app.movables.group.children[index].quaternion.w)));
    },
  };
  Object.assign(window, { __viewer: hook });
}

try {
  start();
} catch (error) {
  // A page that cannot draw says so instead of staying empty.
  document.body.append(el("p", "broken", `This view could not be drawn: ${String(error)}. A browser with WebGL 2 is needed.`));
  throw error;
}
