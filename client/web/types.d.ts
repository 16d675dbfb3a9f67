// The shapes that travel between page and server, for the type checker only: the browser never loads this file.

/** A pinhole camera: metres east, north, up of the domain's south-west corner; degrees. */
export interface Camera {
  position_m: [number, number, number];
  azimuth_deg: number;
  elevation_deg: number;
  vertical_fov_deg: number;
  exposure_ev?: number;
}

/** A world's numbers after a tick. */
export interface Numbers {
  tick: number;
  simulated_s: number;
  utc: string;
  tick_ms: number;
  frame_ms: number | null;
  substeps: number;
  substep_s: number;
  speed: number;
  time_scale: number;
  paused: boolean;
  spinning_up: boolean;
  cloud_cover: number | null;
  cloud_base_m: number | null;
  cloud_top_m: number | null;
  liquid_water_path_kg_m2: number | null;
  total_water_path_kg_m2: number | null;
  updraught_max_m_s: number;
  wind_max_m_s: number;
  courant: number;
  divergence_max_per_s: number;
  sun_elevation_deg: number;
  sun_azimuth_deg: number;
  health: "good" | "degraded" | "halted";
  trouble_code: string | null;
  trouble_message: string | null;
  trouble_tick: number | null;
  retries: number;
  restores: number;
}

export interface ApiError { code: string; message: string; pointer?: string }

export interface Hello {
  type: "hello";
  protocol: number;
  server: string;
  world: string;
  scene: string;
  cells: [number, number, number];
  cell_size_m: [number, number, number];
  camera: Camera;
}

export type ServerMessage = Hello | { type: "tick"; numbers: Numbers } | { type: "error"; error: ApiError };

export type Sun = { from: "clock" } | { from: "fixed"; elevation_deg: number; azimuth_deg: number };

export type Command =
  | { command: "pause" }
  | { command: "resume" }
  | { command: "time_scale"; time_scale: number }
  | { command: "sun"; sun: Sun };

export type ClientMessage =
  | { type: "frames"; width: number; height: number; format: "jpeg" | "png" | "webp"; max_fps: number; camera: Camera | null }
  | { type: "no_frames" }
  | { type: "command"; command: Command };

/** The header of a binary frame message, and its image. */
export interface Frame {
  mime: string;
  width: number;
  height: number;
  tick: number;
  simulated_s: number;
  render_ms: number;
  encode_ms: number;
  sequence: number;
  image: Uint8Array<ArrayBuffer>;
}

export interface WorldSummary { id: string; scene: string; cells: [number, number, number]; device: string; numbers: Numbers }

export interface SceneSummary { name: string; description: string }

/** How the connection stands; `retry_s` counts down while it is lost. */
export type Status =
  | { state: "connecting" }
  | { state: "live" }
  | { state: "lost"; retry_s: number; why: string };
