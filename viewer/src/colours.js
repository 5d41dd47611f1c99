// The viridis map (van der Walt and Smith 2015) at nine stops: readable with any colour vision.
const STOPS = [
  [0.267, 0.005, 0.329], [0.279, 0.175, 0.483], [0.23, 0.322, 0.546], [0.173, 0.449, 0.558],
  [0.128, 0.567, 0.551], [0.158, 0.684, 0.502], [0.369, 0.789, 0.383], [0.678, 0.864, 0.19],
  [0.993, 0.906, 0.144],
];

export function colourAt(share, target, offset) {
  const position = Math.min(1, Math.max(0, share)) * (STOPS.length - 1);
  const first = Math.min(STOPS.length - 2, Math.floor(position));
  const part = position - first;
  for (let c = 0; c < 3; c += 1) {
    target[offset + c] = (1 - part) * STOPS[first][c] + part * STOPS[first + 1][c];
  }
}

export function paintScale(canvas) {
  canvas.width = 160;
  canvas.height = 1;
  const context = canvas.getContext('2d');
  const rgb = [0, 0, 0];
  for (let x = 0; x < canvas.width; x += 1) {
    colourAt(x / (canvas.width - 1), rgb, 0);
    context.fillStyle = `rgb(${rgb.map((value) => Math.round(255 * value)).join(',')})`;
    context.fillRect(x, 0, 1, 1);
  }
}
