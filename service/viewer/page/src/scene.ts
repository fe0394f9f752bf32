// Starts the page of a scan: stage, layers, panel, keyboard, pointer, URL and what tests ask.
import { Box3, Plane, Vector3 } from "three";
import { button, el } from "./dom";
import { Labels } from "./labels";
import { Layer } from "./layer";
import { Piece, Scan, readScan } from "./scene-data";
import { COLOURINGS, Colouring, Hits, Origin, OwnedPoints, PieceGlass, Sensors, Sight, Slice } from "./scene-layers";
import { ScenePanel } from "./scene-panel";
import { Stage } from "./stage";
import { THEMES } from "./theme";

const AHEAD = new Vector3(1, 0, 0);
// From where one looks at the middle: as an operator over the robot's shoulder, as the robot, from its left, from above.
const CAMERAS: Record<string, Vector3> = {
  "3d": new Vector3(-1, 0.55, 0.55), ahead: new Vector3(-1, 0, 0.06), side: new Vector3(0, 1, 0.04), top: new Vector3(-1e-3, 0, 1),
};

function start(): void {
  const scan = readScan();
  const viewport = el("main", "viewport");
  const overlay = el("div", "labels");
  const tip = el("div", "tip");
  tip.hidden = true;
  viewport.append(overlay, tip);
  const labels = new Labels(overlay);
  const box = new Box3();
  const p = new Vector3();
  for (let i = 0; i < scan.cloud.length; i += 3) box.expandByPoint(p.fromArray(scan.cloud, i));
  if (box.isEmpty()) box.set(new Vector3(-1, -1, 0), new Vector3(1, 1, 1));
  // What stands about is looked at, not all of the floor, nor a few pieces far away.
  const subject = middleOf(scan);

  const tools = el("div", "tools");
  const head = el("header", "top", el("div", "what", el("h1", "", scan.title), el("span", "says", says(scan))), tools);
  document.body.append(head, viewport);
  document.body.classList.add("still", "scan");
  // A robot's operator stands behind it and looks ahead.
  const stage = new Stage(viewport, { box, heading: AHEAD.clone(), side: 1, hand: () => undefined });
  const show = (camera: string, isSudden = false): void => {
    const direction = CAMERAS[camera].clone().normalize();
    const centre = subject.getCenter(new Vector3());
    stage.moveTo(centre.clone().addScaledVector(direction, stage.fitting(direction, subject)), centre, isSudden);
  };

  const pieces = new PieceGlass(scan, "pieces", "Convex pieces", "p", (piece) => !["floor", "unknown"].includes(piece.kind), 0.3);
  const floor = new PieceGlass(scan, "floor", "Floor pieces", "f", (piece) => piece.kind === "floor", 0.35);
  const unknown = new PieceGlass(scan, "unknown", "Never seen", "u", (piece) => piece.kind === "unknown", 0.12);
  const cloud = new OwnedPoints(scan);
  const hits = new Hits(scan);
  const slice = new Slice(scan.space);
  const sensors = new Sensors(scan);
  const origin = new Origin();
  unknown.group.visible = false;  // a fog that hides what there is
  const layers: Layer[] = [cloud, pieces, floor, unknown, hits, slice, sensors, origin];
  for (const layer of layers) stage.scene.add(layer.group);
  for (const label of [...hits.labels, ...sensors.labels, ...origin.labels]) labels.add(label);
  let theme: "dark" | "light" = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";

  const set = (layer: Layer, on: boolean): void => {
    layer.group.visible = on;
    for (const one of [hits, sensors, origin]) if (layer === one) for (const label of one.labels) label.isOn = on;
    panel.refresh();
    stage.draw();
  };
  const chooseHit = (index: number): void => {
    panel.choose(index);
    lookAt(hits.extent(index));
  };
  const chooseMesh = (index: number): void => {
    const extent = new Box3();
    const place = new Vector3();
    for (const { hull } of scan.pieces.filter(({ name }) => scan.meshes[index].pieces.includes(name))) {
      for (let i = 0; i < hull.vertices.length; i += 3) extent.expandByPoint(place.fromArray(hull.vertices, i));
    }
    const pose = scan.meshes[index].pose_world_mesh;
    if (extent.isEmpty() && pose) extent.expandByPoint(place.set(pose[0][3], pose[1][3], pose[2][3])).expandByScalar(0.3);
    if (!extent.isEmpty()) lookAt(extent);
  };
  const lookAt = (thing: Box3): void => {
    const extent = thing.expandByScalar(0.15);
    const centre = extent.getCenter(new Vector3());
    const direction = stage.camera.position.clone().sub(stage.controls.target).normalize();
    stage.moveTo(centre.clone().addScaledVector(direction, stage.fitting(direction, extent)), centre);
  };
  const choosePiece = (index: number): void => {
    pieces.choose(index);
    panel.showPiece(scan.pieces[index]);
    stage.draw();
  };
  let isCut = false;
  let colouring: Colouring = "piece";
  // What lies on the side that one looks from is cut off at the slice: what is above it, before it, left of it.
  const cut = (on: boolean): void => {
    isCut = on;
    const sign = slice.axis === 0 ? 1 : -1;
    const normal = new Vector3().setComponent(slice.axis, sign);
    stage.renderer.clippingPlanes = on ? [new Plane(normal, 1e-3 - sign * slice.at)] : [];
    panel.tell(isCut, colouring);
    stage.draw();
  };
  const colourBy = (wanted: Colouring): void => {
    colouring = wanted;
    pieces.colourBy(colouring);
    panel.tell(isCut, colouring);
    stage.draw();
  };
  const moveSlice = (axis: number, at: number): void => {
    slice.move(axis, at);
    set(slice, true);
    cut(isCut);
  };
  const panel = new ScenePanel(scan, layers, slice, {
    toggle: (layer) => set(layer, !layer.group.visible), chooseHit, chooseMesh, choosePiece, moveSlice, cut, colourBy,
  });
  document.body.append(panel.element);
  const recolour = (to: "dark" | "light"): void => {
    theme = to;
    document.documentElement.dataset.theme = to;
    for (const layer of layers) layer.recolour(THEMES[to]);
    stage.recolour(THEMES[to]);
  };
  for (const camera of Object.keys(CAMERAS)) tools.append(button("", camera, `Camera: ${camera}`, () => show(camera)));
  tools.append(button("round", "◐", "Dark or light (d)", () => recolour(theme === "dark" ? "light" : "dark")));

  stage.onFrame = () => labels.place(stage.camera, ...stage.size);
  recolour(theme);
  stage.resize();
  show("3d", true);
  panel.tell(isCut, colouring);
  const roof = roofOver(scan.pieces, subject);
  if (roof !== undefined) {
    moveSlice(2, roof - 0.3);
    set(slice, false);
    cut(true);
  }

  const under = (event: MouseEvent): { name: string; index: number; point: Vector3 } | undefined => {
    const seen = [pieces, unknown].filter((layer) => layer.group.visible).flatMap((layer) => layer.solids);
    const [hit] = stage.ray(event.clientX, event.clientY).intersectObjects(seen.map(({ mesh }) => mesh), false);
    const found = hit && seen.find(({ mesh }) => mesh === hit.object);
    return found && { name: found.piece.name, index: found.index, point: hit.point };
  };
  const canvas = stage.renderer.domElement;
  canvas.addEventListener("pointermove", (event) => {
    const found = event.buttons === 0 ? under(event) : undefined;
    tip.hidden = !found;
    if (!found) return;
    tip.textContent = `${found.name}  (${found.point.toArray().map((x) => x.toFixed(2)).join(", ")}) m`;
    const rect = canvas.getBoundingClientRect();
    tip.style.transform = `translate(${event.clientX - rect.left + 14}px, ${event.clientY - rect.top + 12}px)`;
  });
  let pressed = [0, 0];
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
  canvas.addEventListener("click", (event) => {
    if (Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4) choosePiece(under(event)?.index ?? -1);
  });
  canvas.addEventListener("dblclick", (event) => {
    const found = under(event);
    if (found) stage.focus(found.point);
  });
  const step = (sign: number): void => moveSlice(slice.axis, slice.at + sign * scan.space.size);
  const acts: Record<string, () => void> = {
    d: () => recolour(theme === "dark" ? "light" : "dark"), l: () => document.body.classList.toggle("unlabelled"),
    x: () => cut(!isCut), k: () => colourBy(following(colouring, scan)),
    ArrowUp: () => step(1), ArrowDown: () => step(-1), Escape: () => choosePiece(-1),
  };
  Object.keys(CAMERAS).forEach((camera, i) => { acts[String(i + 1)] = () => show(camera); });
  for (const layer of layers) acts[layer.key] = () => set(layer, !layer.group.visible);
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLInputElement) return;
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });

  // #camera=top&layers=points,free&slice=z:0.8&theme=light&hit=0
  const followHash = (): void => {
    const wanted = new URLSearchParams(location.hash.slice(1));
    const colour = wanted.get("theme");
    if (colour === "dark" || colour === "light") recolour(colour);
    const names = wanted.get("layers")?.split(",");
    if (names) for (const layer of layers) set(layer, names.includes(layer.name));
    const [axis, at] = (wanted.get("slice") ?? "").split(":");
    if ("xyz".includes(axis) && axis !== "" && Number.isFinite(Number(at))) moveSlice("xyz".indexOf(axis), Number(at));
    if (wanted.has("cut")) cut(wanted.get("cut") === "1");
    const colours = wanted.get("colour");
    if (colours && colours in COLOURINGS) colourBy(colours as Colouring);
    const camera = wanted.get("camera");
    if (camera && camera in CAMERAS) show(camera, true);
    const hit = Number(wanted.get("hit") ?? NaN);
    if (Number.isInteger(hit) && hit >= 0 && hit < hits.count) chooseHit(hit);
  };
  followHash();
  window.addEventListener("hashchange", followHash);
  Object.assign(window, { __viewer: {
    ready: true,
    counts: Object.fromEntries(layers.map((layer) => [layer.name, layer.count])),
    get busy(): boolean { return stage.isBusy; },
    get slice(): [number, number] { return [slice.axis, slice.at]; },
    get target(): number[] { return stage.controls.target.toArray(); },
    get isCut(): boolean { return isCut; },
    get colouring(): Colouring { return colouring; },
    moveSlice, choosePiece,
    outlineOf: (index: number): number[] => hits.outlineOf(index),
    sightAt(place: number[]): Sight {
      const [x, y, z] = place.map((value, i) => Math.floor((value - scan.space.lower[i]) / scan.space.size));
      return slice.sightOf(x, y, z);
    },
    project: (place: number[]): number[] => stage.pixel(new Vector3().fromArray(place)),
  } });
}

// Where most points of pieces are; around the world's origin, where the robot is, if there are none.
function middleOf(scan: Scan): Box3 {
  const owned = [...scan.owner.keys()].filter((i) => scan.owner[i] < scan.pieces.length);
  if (owned.length === 0) return new Box3(new Vector3(-1, -1, 0), new Vector3(1, 1, 1));
  const [low, high] = [new Vector3(), new Vector3()];
  for (let axis = 0; axis < 3; axis++) {
    const places = Float32Array.from(owned, (i) => scan.cloud[3 * i + axis]).sort();
    low.setComponent(axis, places[Math.floor(FEW * (places.length - 1))]);
    high.setComponent(axis, places[Math.ceil((1 - FEW) * (places.length - 1))]);
  }
  return new Box3(low, high).expandByScalar(0.2);
}

const FEW = 0.03;  // of the points, that may lie outside of what is looked at
const ROOF = 1.4;  // [m] above the lowest: nobody looks in through what hangs there

// The lowest height of pieces that hang over a good part of what is looked at; undefined under an open sky.
function roofOver(pieces: Piece[], subject: Box3): number | undefined {
  const size = subject.getSize(new Vector3());
  let [covered, lowest] = [0, Infinity];
  const box = new Box3();
  const p = new Vector3();
  for (const { hull } of pieces.filter((piece) => piece.kind !== "unknown")) {
    box.makeEmpty();
    for (let i = 0; i < hull.vertices.length; i += 3) box.expandByPoint(p.fromArray(hull.vertices, i));
    if (box.min.z < subject.min.z + ROOF) continue;
    const own = box.getSize(p);
    covered += own.x * own.y;
    lowest = Math.min(lowest, box.min.z);
  }
  return covered > 0.25 * size.x * size.y ? lowest : undefined;
}

function following(colouring: Colouring, scan: Scan): Colouring {
  const names = (Object.keys(COLOURINGS) as Colouring[]).filter((name) => name !== "change" || scan.pieces.some((piece) => piece.change !== null));
  return names[(names.indexOf(colouring) + 1) % names.length];
}

function says({ figures, pieces }: Scan): string {
  const levels = figures.floor_levels === 0 ? "no floor" : figures.floor_levels === 1 ? "one floor" : `${figures.floor_levels} floor levels`;
  const unseen = pieces.filter((piece) => piece.kind === "unknown").length;
  const seen = many(pieces.length - unseen, "piece") + (unseen ? ` and ${unseen} of unseen space` : "");
  return `${many(figures.points, "point")} · ${seen} · ${levels} · ${Number(figures.time_s).toFixed(1)} s`;
}

const many = (n: number, what: string): string => `${n} ${what}${n === 1 ? "" : "s"}`;

try {
  start();
} catch (error) {
  document.body.append(el("p", "broken", `This view could not be drawn: ${String(error)}. A browser with WebGL 2 is needed.`));
  throw error;
}
