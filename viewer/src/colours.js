// The cividis map (Nunez, Anderton and Renslow 2018) at nine stops: readable with any colour vision.
const STOPS = [
  [0.0, 0.135, 0.305], [0.119, 0.211, 0.423], [0.265, 0.289, 0.421], [0.374, 0.366, 0.43],
  [0.486, 0.445, 0.474], [0.6, 0.526, 0.455], [0.727, 0.613, 0.42], [0.862, 0.707, 0.347],
  [0.995, 0.909, 0.218],
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
