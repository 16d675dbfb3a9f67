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
  moon_elevation_deg: number | null;
  moon_azimuth_deg: number | null;
  moon_distance_m: number | null;
  sidereal_deg: number | null;
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
  | { type: "frames"; width: number; height: number; format: "jpeg" | "png" | "webp"; max_fps: number; camera: Camera | null; quality: "live" | "still" | "resting"; header: number }
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
  /** How it came to be sent when it was; null where the server speaks the first header only. */
  delivery: { sent_unix_ms: number; age_ms: number; wait_ms: number; still: boolean } | null;
  /** When it came, by this computer's clock. */
  arrived_unix_ms: number;
  image: Uint8Array<ArrayBuffer>;
}

export interface WorldSummary { id: string; scene: string; cells: [number, number, number]; device: string; numbers: Numbers }

export interface SceneSummary { name: string; description: string }

/** How the connection stands; `retry_s` counts down while it is lost. */
export type Status =
  | { state: "connecting" }
  | { state: "live" }
  | { state: "lost"; retry_s: number; why: string };

/** The kernels that draw pictures, as `GET /v1/shaders/view.json` gives them. */
export interface ViewShaders {
  modules: Record<string, { wgsl: string; bindings: { name: string; binding: number; kind: "uniform" | "read" | "write"; uniform?: string }[] }>;
  kernels: Record<string, ShaderKernel>;
  structs: Record<string, ShaderStruct>;
  constants: Record<string, number>;
}

/** `late` says that few worlds want it. */
export interface ShaderKernel { module: string; entry: string; workgroup_size: [number, number, number]; late?: boolean }

export interface ShaderStruct {
  size_bytes: number;
  members: { name: string; kind: string; offset_bytes: number; size_bytes: number }[];
}

/** What a world tells the kernels, as `GET /v1/worlds/{id}/scenery` gives it. */
export interface Scenery {
  uniforms: Record<"Air" | "SkyView" | "SkyLightAsk" | "SunMarch" | "ViewFrame" | "MarchPhase" | "OctaveBalancing", Record<string, number | number[]>>;
  /** Why these kernels cannot draw this world; absent where they can. */
  server_draws?: string | null;
  /** Absent where no stars are drawn; the words are at `/v1/worlds/{id}/stars.bin`. */
  stars?: { latitude_deg: number; faintest_magnitude: number; years_since_2000: number } | null;
}

/** What stands in the sky: towards the sun, towards the moon and how far it is, the right ascension that culminates. */
export interface Lights {
  sun: number[];
  moon: { direction: number[]; distance_m: number } | null;
  sidereal_deg: number | null;
}

/** A cloud that is drawn: extinction at cell centres, `[z][y][x]`, 1/m. */
export interface Cloud {
  cells: [number, number, number];
  cell_size_m: [number, number, number];
  extinction_per_m: Float32Array;
  /** How far the cloudy air has moved east and north since the start, m. */
  air_displacement_m: [number, number];
}

/** The header of a volume, see proto/PROTOCOL.md. */
export interface VolumeHeader {
  keyframe: boolean;
  compressed: boolean;
  view: number;
  sequence: number;
  /** Sequence of the keyframe that it builds on. */
  base: number;
  mip: number;
  tick: number;
  simulated_s: number;
  published_unix_s: number;
  encoded_unix_s: number;
  /** Of the world's cells. */
  cell_size_m: [number, number, number];
  world_cells: [number, number, number];
  region: { from: [number, number, number]; cells: [number, number, number] };
  /** Cells of the volume itself. */
  cells: [number, number, number];
  brick: [number, number, number];
  sun_direction: [number, number, number];
  air_displacement_m: [number, number];
  body_bytes: number;
  raw_bytes: number;
  channels: { name: string; bits: number; square: boolean; offset: number; scale: number }[];
  /** Where the body begins. */
  body_at: number;
}

/** A volume: the codes of each channel, `[z][y][x]`. */
export interface VolumeField { header: VolumeHeader; codes: (Uint8Array | Uint16Array)[] }

/** A moment that the server has kept, as `GET /v1/worlds/{id}/past` lists it. */
export interface PastMoment { tick: number; simulated_s: number; published_unix_s: number; bytes: number }

export interface VolumeSubscription {
  channels: string[];
  rate_hz: number;
  bits: 8 | 16;
  mip?: number;
  compression: "none" | "deflate";
}
