// The licence of three.js travels with the bundle that contains it.
import { copyFileSync } from 'node:fs';

copyFileSync('node_modules/three/LICENSE', '../src/ostiform/report/assets/three-LICENSE.txt');
