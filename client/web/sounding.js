// @ts-check
// A sounding as a skew-T log-p diagram: temperature and dew point over pressure, with dry and moist adiabats and the wind.

/**
 * A column from the ground up.
 * @typedef {object} Column
 * @property {Float32Array} pressure_pa
 * @property {Float32Array} temperature_k
 * @property {Float32Array} humidity relative, 0 to 1
 * @property {Float32Array} wind_x_m_s
 * @property {Float32Array} wind_y_m_s
 */

const ZERO_CELSIUS_K = 273.15;
const KAPPA = 0.2857;
/** Degrees that an isotherm leans to the right for a factor e in pressure. */
const SKEW_K = 45;

/**
 * Dew point over water, K (Bolton 1980, the inverse of his equation 10).
 * @param {number} temperature_k
 * @param {number} humidity
 */
export function dewPoint(temperature_k, humidity) {
  const t = temperature_k - ZERO_CELSIUS_K;
  const log = Math.log(Math.max(humidity, 1e-4)) + (17.67 * t) / (t + 243.5);
  return ZERO_CELSIUS_K + (243.5 * log) / (17.67 - log);
}

/**
 * How fast saturated air cools with the logarithm of pressure, K (pseudo-adiabatic).
 * @param {number} temperature_k
 * @param {number} pressure_pa
 */
function moistSlope(temperature_k, pressure_pa) {
  const t = temperature_k - ZERO_CELSIUS_K;
  const vapour_pa = 611.2 * Math.exp((17.67 * t) / (t + 243.5));
  const ratio = (0.622 * vapour_pa) / Math.max(pressure_pa - vapour_pa, 1);
  const [latent, heat, gas] = [2.501e6, 1004.64, 287.04];
  return (
    (gas * temperature_k + latent * ratio) / (heat + (latent * latent * ratio * 0.622) / (gas * temperature_k * temperature_k))
  );
}

/**
 * Draws the diagram and says in words what a reader of it sees first.
 * @param {HTMLCanvasElement} canvas
 * @param {Column} column
 */
export function drawSounding(canvas, { pressure_pa, temperature_k, humidity, wind_x_m_s, wind_y_m_s }) {
  const count = pressure_pa.length;
  const ratio = Math.min(2, devicePixelRatio || 1);
  canvas.width = Math.round(Math.max(1, canvas.clientWidth) * ratio);
  canvas.height = Math.round(canvas.width * 0.9);
  const context = canvas.getContext("2d");
  if (context === null || count === 0) {
    return "nothing is known.";
  }
  const { width, height } = canvas;
  const [low_pa, high_pa] = [pressure_pa[count - 1] * 0.98, pressure_pa[0] * 1.005];
  const reach = Math.log(high_pa / low_pa);
  const dew_k = temperature_k.map((t, n) => dewPoint(t, humidity[n]));
  /** @param {number} p_pa */
  const skew = (p_pa) => SKEW_K * Math.log(high_pa / p_pa);
  let [left, right] = [Infinity, -Infinity];
  for (let n = 0; n < count; n++) {
    left = Math.min(left, Math.max(dew_k[n], temperature_k[n] - 30) + skew(pressure_pa[n]));
    right = Math.max(right, temperature_k[n] + skew(pressure_pa[n]));
  }
  [left, right] = [left - 3, right + 3];
  const margin = 34 * ratio;
  const plotWidth = width - 2 * margin;
  /** @param {number} t_k @param {number} p_pa @returns {[number, number]} */
  const place = (t_k, p_pa) => [
    margin + ((t_k + skew(p_pa) - left) / (right - left)) * plotWidth,
    (1 - Math.log(high_pa / p_pa) / reach) * (height - 16 * ratio),
  ];
  context.fillStyle = "#0d141d";
  context.fillRect(0, 0, width, height);
  context.font = `${10 * ratio}px sans-serif`;
  context.save();
  context.beginPath();
  context.rect(margin, 0, plotWidth, height - 16 * ratio);
  context.clip();
  /** @param {string} style @param {number} wide @param {(line: (t_k: number, p_pa: number) => void) => void} draw */
  const curve = (style, wide, draw) => {
    context.beginPath();
    context.strokeStyle = style;
    context.lineWidth = wide * ratio;
    let begun = false;
    draw((t_k, p_pa) => {
      const [x, y] = place(t_k, p_pa);
      if (begun) {
        context.lineTo(x, y);
      } else {
        context.moveTo(x, y);
        begun = true;
      }
    });
    context.stroke();
  };
  const steps = Array.from({ length: 41 }, (_, n) => high_pa * (low_pa / high_pa) ** (n / 40));
  for (let t = -100; t <= 60; t += 10) {
    curve("#2c3a4a", 1, (line) => steps.forEach((p) => line(t + ZERO_CELSIUS_K, p)));
  }
  // Dry adiabats by potential temperature, then moist ones from temperatures at the ground.
  for (let theta = 270; theta <= 360; theta += 5) {
    curve("#5a4632", 0.8, (line) => steps.forEach((p) => line(theta * (p / 1e5) ** KAPPA, p)));
  }
  for (let start = 268; start <= 308; start += 5) {
    curve("#2f5a48", 0.8, (line) => {
      let t = start;
      steps.forEach((p, n) => {
        if (n > 0) {
          t += moistSlope(t, p) * Math.log(p / steps[n - 1]);
        }
        line(t, p);
      });
    });
  }
  curve("#7ec8ff", 2, (line) => dew_k.forEach((t, n) => line(t, pressure_pa[n])));
  curve("#ff8a70", 2, (line) => temperature_k.forEach((t, n) => line(t, pressure_pa[n])));
  context.restore();
  context.fillStyle = "#9fb2c6";
  for (let hPa = 1000; hPa * 100 > low_pa; hPa -= 50) {
    if (hPa * 100 < high_pa) {
      context.fillText(String(hPa), 2 * ratio, place(ZERO_CELSIUS_K, hPa * 100)[1] + 3 * ratio);
    }
  }
  for (let t = -60; t <= 60; t += 10) {
    const x = place(t + ZERO_CELSIUS_K, high_pa)[0];
    if (x > margin && x < width - margin) {
      context.fillText(`${t}°`, x - 6 * ratio, height - 4 * ratio);
    }
  }
  context.strokeStyle = "#ffd166";
  context.lineWidth = 1.2 * ratio;
  context.beginPath();
  const every = Math.max(1, Math.round(count / 14));
  let strongest = 0;
  for (let n = 0; n < count; n++) {
    const speed = Math.hypot(wind_x_m_s[n], wind_y_m_s[n]);
    strongest = Math.max(strongest, speed);
    if (n % every === 0) {
      const y = place(ZERO_CELSIUS_K, pressure_pa[n])[1];
      const x = width - margin / 2;
      const length = Math.min(1, speed / 20) * 0.5 * margin;
      const [dx, dy] = speed > 0 ? [(wind_x_m_s[n] / speed) * length, (-wind_y_m_s[n] / speed) * length] : [0, 0];
      context.moveTo(x - dx, y - dy);
      context.lineTo(x + dx, y + dy);
      context.lineTo(x + 0.4 * dx - 0.3 * dy, y + 0.4 * dy + 0.3 * dx);
    }
  }
  context.stroke();
  const saturated = humidity.findIndex((h) => h > 0.995);
  const ground = `${(temperature_k[0] - ZERO_CELSIUS_K).toFixed(1)} °C, dew point ${(dew_k[0] - ZERO_CELSIUS_K).toFixed(1)} °C at ${(pressure_pa[0] / 100).toFixed(0)} hPa`;
  const cloud = saturated < 0 ? "no saturated level" : `saturated from ${(pressure_pa[saturated] / 100).toFixed(0)} hPa up`;
  return `${ground}; ${cloud}; wind up to ${strongest.toFixed(0)} m/s.`;
}
