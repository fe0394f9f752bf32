// Colours of both themes, and the one scale that means time (ghosts, traces and timeline share it).
import { Color } from "three";

export interface Colours {
  robot: string; joint: string; left: string; right: string; edge: string; floor: string; grid: string;
  piece: string; pieceEdge: string; movable: string; cloud: string; support: string; zmp: string; com: string;
  target: string; contact: string; bad: string; shadow: number; ghost: number; sky: string; ground: string; unseen: string; unshaped: string;
  load: string; force: string; hold: string; region: string; simulated: string; pose: string;
}

export const THEMES: Record<"dark" | "light", Colours> = {
  dark: {
    robot: "#d5dbe4", joint: "#8b97a8", left: "#2dd4bf", right: "#fbbf24", edge: "#0b0e13", floor: "#1c222c",
    grid: "#566375", piece: "#7fa3d8", pieceEdge: "#a9c4ec", movable: "#f4633a", cloud: "#8fd0b4",
    support: "#38bdf8", zmp: "#facc15", com: "#ffffff", target: "#4ade80", contact: "#a5b4fc", bad: "#ff5c5c",
    shadow: 0.5, ghost: 1.0, sky: "#dfe8f5", ground: "#3a4252", unseen: "#05070a", unshaped: "#e879f9",
    load: "#22d3ee", force: "#f0abfc", hold: "#34d399", region: "#a3e635", simulated: "#fb923c", pose: "#4cc3ff",
  },
  light: {
    robot: "#a9b5c7", joint: "#7d8ba1", left: "#0d9488", right: "#e08a00", edge: "#1e2633", floor: "#eef1f5",
    grid: "#9aa7b8", piece: "#5b7fb8", pieceEdge: "#486a9f", movable: "#e2491d", cloud: "#2f9e77",
    support: "#0284c7", zmp: "#c79200", com: "#111827", target: "#15a34a", contact: "#6366f1", bad: "#dc2626",
    shadow: 0.22, ghost: 1.15, sky: "#ffffff", ground: "#dfe5ee", unseen: "#4b5565", unshaped: "#c026d3",
    load: "#0891b2", force: "#7c3aed", hold: "#059669", region: "#4d7c0f", simulated: "#ea580c", pose: "#0b84c9",
  },
};

const SCALE = ["#4f7cff", "#8b5cf6", "#d946ef", "#fb5a8c", "#ff9a5c"].map((hex) => new Color(hex));

// u from 0 (start) to 1 (end).
export function timeColour(u: number): Color {
  const x = Math.min(Math.max(u, 0), 1) * (SCALE.length - 1);
  const i = Math.min(Math.floor(x), SCALE.length - 2);
  return SCALE[i].clone().lerp(SCALE[i + 1], x - i);
}
